// Points of a sweep where tracked objects are, or voxels in which the sweeps near in time saw
// almost only dynamic objects.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "docdepth/detections/classification.hpp"
#include "docdepth/evidence/track_objects.hpp"

namespace docdepth {

/// Keys of the dynamic voxels of a sweep, ascending.
///
/// A few returns of the sweep in such a voxel most likely belong to the same object, though they
/// are too few for an object or too few key frames saw them.
///
/// @param around   detections of the sweeps from `first` on, at least of those within the window
/// @param times    of all sweeps [s]
/// @param tracked  objects that are dynamic by tracking, besides those that are by their votes
/// @param window   sweeps within this time of the sweep are used [s]; 0 gives no voxels
std::vector<std::uint64_t> dynamic_voxels(
    std::size_t sweep, std::size_t first,
    const std::vector<std::shared_ptr<const Detections>>& around, const std::vector<double>& times,
    const std::vector<TrackedSweep>& tracked, double window);

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
