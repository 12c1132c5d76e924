// The objects of one sweep, small enough to be kept for a whole drive.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "docdepth/detections/constants.hpp"
#include "docdepth/detections/ground_heights.hpp"
#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/mesh/scan_mesh.hpp"

namespace docdepth {

/// Connected returns above the ground.
///
/// Areas are squared ranges, summed over points: what a return covers across its ray grows so. They
/// stay the same while the object comes nearer, where numbers of points grow a hundredfold. Their
/// unit is square metres over the solid angle between two rays.
struct Detection {
  std::uint32_t first = 0;    ///< row of its first point
  std::uint32_t points = 0;   ///< number of its points
  std::uint32_t dynamic = 0;  ///< how many of them the votes call dynamic
  float area = 0;             ///< of its points
  float dynamic_area = 0;     ///< of those that the votes call dynamic
  float free_area = 0;        ///< of those whose place was free before or after; 0 of porous things
  std::int32_t first_occupied = 0;  ///< median of the first sweeps that found a place occupied
  std::int32_t last_occupied = 0;   ///< the same of the last ones
  /// The sweeps before and after which kStandingShare of its places were found occupied.
  std::int32_t stands_since = 0, stands_until = 0;
  float time_offset = 0;  ///< mean time of its points [s after the sweep's stamp]
  Eigen::Vector3f middle = Eigen::Vector3f::Zero();  ///< mean of its points in the LiDAR frame
  Extent box{};                                      ///< in the world
  Height ground;                                     ///< under it, in the world
  TimedSurface surface;  ///< in the world; times after the sweep's stamp
  TimedPoints edges;     ///< beside which the background shows: there it ends
  TimedPoints hidden;    ///< beside which something nearer hides how it goes on

  bool is_dynamic() const { return 2 * dynamic >= points; }
  /// Whether most of its place was free before or after.
  bool was_free() const { return free_area >= kMinFreeShare * area; }
  /// What of it is here for a while only, by the votes or by their order.
  float passing_area() const { return std::max(dynamic_area, free_area); }
  float passing_share() const { return passing_area() / area; }
  /// Whether it is here for a while only, as far as the votes tell.
  bool is_passing() const { return is_dynamic() || was_free(); }
  float range() const { return std::sqrt(area / float(points)); }  ///< of its points [m]
  const SampledPoints& samples() const { return surface.points; }
};

using Detections = std::vector<Detection>;

/// Whether an object is as large as a lorry or a bus.
inline bool is_large(const Extent& box) {
  const Eigen::Vector3f size = box.size();
  return size.z() > kMaxVanHeight ||
         (size.z() > kMaxCarHeight && size.head<2>().maxCoeff() > kMaxVanLength);
}

/// How far apart the samples of an object may be, however many they are [m].
inline float largest_spacing(const Extent& box) {
  return is_large(box) ? kMaxSampleSpacing : INFINITY;
}

/// What is known about each point of a sweep.
struct PointEvidence {
  const bool* ground;
  const std::uint32_t* objects;        ///< row of the first point of its object (cluster_objects)
  const bool* dynamic;                 ///< whether the votes call it dynamic
  const bool* one_stay;                ///< its place was free before or after one stay (Votes)
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
