// Voxels in which the sweeps near in time saw almost only dynamic objects.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "docdepth/evidence/track_objects.hpp"

namespace docdepth {

/// Key of the voxel that holds a point.
std::uint64_t voxel_of(const Eigen::Vector3f& point);

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

}  // namespace docdepth
