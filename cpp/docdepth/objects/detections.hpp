// The objects of one sweep, small enough to be kept for a whole drive.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Connected returns above the ground.
struct Detection {
  std::uint32_t first = 0;    ///< row of its first point
  std::uint32_t points = 0;   ///< number of its points
  std::uint32_t dynamic = 0;  ///< how many of them the votes call dynamic
  Extent box;                 ///< in the world
  SampledPoints samples;      ///< in the world

  bool is_dynamic() const { return 2 * dynamic >= points; }
};

using Detections = std::vector<Detection>;

/// The objects of a sweep with at least kMinDetectionPoints points, ordered by their first point.
///
/// @param objects        row of the first point of each point's object (cluster_objects)
/// @param dynamic        whether the votes call a point dynamic
/// @param T_world_lidar  with an origin so near that float resolves centimetres
Detections detect_objects(const Points& points, const bool* ground, const std::uint32_t* objects,
                          const bool* dynamic, const Pose& T_world_lidar);

}  // namespace docdepth
