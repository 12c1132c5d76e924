// Voxels in which the sweeps near in time saw almost only dynamic objects.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/objects/tracking.hpp"

namespace docdepth {

/// Key of the voxel that holds a point.
std::uint64_t voxel_of(const Eigen::Vector3f& point);

/// Keys of the dynamic voxels of each sweep, ascending.
///
/// A few returns of the sweep in such a voxel most likely belong to the same object, though they
/// are too few for an object or too few key frames saw them.
///
/// @param times    of the sweeps [s]
/// @param tracked  objects that are dynamic by tracking, besides those that are by their votes
/// @param window   sweeps within this time of a sweep are used [s]; 0 gives no voxels
std::vector<std::vector<std::uint64_t>> dynamic_voxels(
    const std::vector<const Detections*>& detections, const std::vector<double>& times,
    const std::vector<TrackedSweep>& tracked, double window, int threads);

}  // namespace docdepth
