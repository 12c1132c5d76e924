// The rays of a sweep, those that end in one place as one.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Rays of one object, or of what stands, that end in one cell: their mean.
struct Ray {
  Eigen::Vector3f origin, end;  ///< LiDAR frame at the stamp of the sweep [m]
  float seconds;                ///< after the stamp
  std::uint32_t count;          ///< of rays
  std::uint16_t object;         ///< 0 for what stands
  bool ground;
};

/// Rays that end in one cell pass nearly the same voxels, and cost as much as one of them.
///
/// @param points, origins  of each ray, in the LiDAR frame at the stamp [m], finite
/// @param cell  edge of a cell [m]
std::vector<Ray> merge_rays(const Points& points, const Points& origins, const float* seconds,
                            const std::uint16_t* object, const bool* ground, double cell);

}  // namespace docdepth
