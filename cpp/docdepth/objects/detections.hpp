// The objects of one sweep, small enough to be kept for a whole drive.
#pragma once

#include <cstdint>
#include <vector>

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
  float free_area = 0;        ///< of those whose place a key frame observed free
  float time_offset = 0;      ///< mean time of its points [s after the sweep's stamp]
  Extent box{};               ///< in the world
  SampledSurface surface;     ///< in the world

  bool is_dynamic() const { return 2 * dynamic >= points; }
  const SampledPoints& samples() const { return surface.points; }
};

using Detections = std::vector<Detection>;

/// What is known about each point of a sweep.
struct PointEvidence {
  const bool* ground;
  const std::uint32_t* objects;        ///< row of the first point of its object (cluster_objects)
  const bool* dynamic;                 ///< whether the votes call it dynamic
  const std::uint16_t* dynamic_votes;  ///< key frames that observed its place free
  const float* time_offset;            ///< [s after the sweep's stamp]; may be null
};

/// The objects of a sweep with at least kMinDetectionPoints points, ordered by their first point.
///
/// @param T_world_lidar  with an origin so near that float resolves centimetres
Detections detect_objects(const Points& points, const PointEvidence& evidence, const ScanMesh& mesh,
                          const Pose& T_world_lidar);

}  // namespace docdepth
