// The objects of one sweep, small enough to be kept for a whole drive.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "docdepth/detections/clustering.hpp"
#include "docdepth/detections/ground_grid.hpp"
#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Objects wider than this are not tracked [m]: longer than any truck, they only occupy space.
constexpr float kMaxObjectWidth = 25.0f;
/// The place of an object was free if that of this share of its area was.
constexpr float kMinFreeShare = 0.5f;
/// An object moves, too, if this share of its area was free at some time: places of people in
/// single file are soon occupied again. So much of a hedge or fence seldom was free.
constexpr float kFoundFreeShare = 0.9f;
/// What was always there may have been hidden, but for this share of its points.
constexpr double kStandingShare = 0.25;
/// An object is kept as at most this many samples, if it is no larger than a van.
constexpr std::size_t kMaxSamples = 100;

/// Connected returns above the ground.
///
/// Areas are squared ranges, summed over points: what a return covers across its ray grows so. They
/// stay the same while the object comes nearer, where numbers of points grow a hundredfold. Their
/// unit is square metres over the solid angle between two rays.
struct Detection {
  std::uint32_t first = 0;           ///< row of its first point
  std::uint32_t points = 0;          ///< number of its points
  std::uint32_t dynamic_points = 0;  ///< how many of them the votes call dynamic
  float area = 0;                    ///< of its points
  float dynamic_area = 0;            ///< of those that the votes call dynamic
  float free_area = 0;    ///< of those whose place was free before or after; 0 of scattered returns
  float porous_area = 0;  ///< of those whose place was hit and passed in turn
  std::int32_t first_occupied = 0;  ///< median of the first sweeps that found a place occupied
  std::int32_t last_occupied = 0;   ///< the same of the last ones
  /// The sweeps before and after which kStandingShare of its places were found occupied.
  std::int32_t stands_since = 0, stands_until = 0;
  float time_offset = 0;  ///< mean time of its points [s after the sweep's stamp]
  Eigen::Vector3f middle = Eigen::Vector3f::Zero();  ///< mean of its points in the LiDAR frame
  Extent box{};                                      ///< in the world
  GroundHeight ground;                               ///< under it, in the world
  TimedSurface surface;  ///< in the world; times after the sweep's stamp
  TimedPoints edges;     ///< beside which the background shows: there it ends
  TimedPoints hidden;    ///< beside which something nearer hides how it goes on

  bool is_dynamic() const { return 2 * dynamic_points >= points; }
  /// Whether most of its place was free before or after.
  bool was_free() const { return free_area >= kMinFreeShare * area; }
  /// What of its place was free at some time, though perhaps occupied again soon.
  float found_free_area() const { return std::max(dynamic_area, free_area + porous_area); }
  /// What of it is here for a while only, by the votes or by their order.
  float transient_area() const { return std::max(dynamic_area, free_area); }
  float transient_share() const { return transient_area() / area; }
  /// Whether it is here for a while only, as far as the votes tell.
  bool is_transient() const {
    return is_dynamic() || was_free() || found_free_area() >= kFoundFreeShare * area;
  }
  float range() const { return std::sqrt(area / float(points)); }  ///< of its points [m]
  const SampledPoints& samples() const { return surface.points; }
};

using Detections = std::vector<Detection>;

/// How far apart the samples of an object may be, however many they are [m].
float largest_spacing(const Extent& box);

/// What is known about each point of a sweep.
struct PointEvidence {
  const bool* ground;
  const std::uint32_t* objects;        ///< row of the first point of its object (cluster_objects)
  const bool* dynamic;                 ///< whether the votes call it dynamic
  const bool* occupied_once;           ///< its place was free before or after one stay (Votes)
  const bool* porous;                  ///< its place was hit and passed in turn (Votes)
  const std::int32_t* first_occupied;  ///< first and last sweep that found its place occupied
  const std::int32_t* last_occupied;
  const float* time_offset;  ///< [s after the sweep's stamp]; may be null
};

/// The objects of a sweep with at least kMinDetectionPoints points, ordered by their first point.
///
/// @param T_world_lidar  with an origin so near that float resolves centimetres
Detections detect_objects(const Points& points, const PointEvidence& evidence, const ScanMesh& mesh,
                          const Pose& T_world_lidar);

}  // namespace docdepth
