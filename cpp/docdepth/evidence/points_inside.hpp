// Points of a sweep where tracked objects are.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/detections/classification.hpp"
#include "docdepth/geometry/oriented_box.hpp"
#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Add points above the ground inside boxes of moving objects or inside dynamic voxels, unless many
/// more of their votes are static than dynamic.
///
/// @param boxes, voxels  in the world of T_world_lidar (TrackedSweep)
void add_points_inside(const Points& points, const bool* ground, const std::uint16_t* static_votes,
                       const std::uint16_t* dynamic_votes, const Pose& T_world_lidar,
                       const std::vector<OrientedBox>& boxes,
                       const std::vector<std::uint64_t>& voxels, std::vector<std::uint8_t>& dynamic,
                       const ClassificationOptions& options = {});

}  // namespace docdepth
