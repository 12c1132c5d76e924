// Tracking: an object that moves at one time is dynamic also while it stands, and where no key
// frame looked. Beyond the paper.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "docdepth/detections/detections.hpp"
#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/tracking/tracker.hpp"

namespace docdepth {

/// A detection of a sweep that belongs to a track.
struct Member {
  std::uint32_t first;  ///< row of its first point
  std::uint32_t track;  ///< number of the track, from 1
  bool is_dynamic;      ///< whether the track makes it dynamic
};

/// Where an object that moves at some time is in a sweep, detected or not.
struct TrackedBox {
  std::uint32_t track;  ///< number of the track, from 1
  bool is_moving;       ///< at the time of the sweep
  OrientedBox box;
};

/// The tracks in one sweep.
struct TrackedSweep {
  std::vector<Member> members;  ///< by their rows
  std::vector<TrackedBox> boxes;
  std::vector<std::uint64_t> voxels;  ///< dynamic voxels, ascending (dynamic_voxels)

  /// Whether a track makes the object with that first point dynamic.
  bool makes_dynamic(std::uint32_t first) const;
};

/// Where an object is in the sweeps that saw it.
struct TrackedObject {
  struct Place {
    std::uint32_t sweep, points;
    Pose T_world_object;  ///< at the sweep's stamp; x forward, z up, origin in the middle of the
                          ///< bottom of the box
    Eigen::Vector3d velocity;
    double deviation;          ///< of the position [m]
    double surface_deviation;  ///< of what was seen of its surface, across itself [m]
  };
  std::vector<Place> places{};
  Eigen::Vector3f size = Eigen::Vector3f::Zero();  ///< length, width and height [m]
  bool rigid = false;
};

/// Takes what tracks found in a sweep; called for each sweep in order.
using TakeSweep = std::function<void(const TrackedSweep& sweep)>;

/// Find the objects that move at some time of the drive, and where they are in each sweep.
///
/// A static detection becomes dynamic only if its place was free while the object was elsewhere,
/// else it is another thing: a parked car that was passed, a pole, a wall. And as much of the
/// object must have been dynamic before: a pedestrian of few points cannot be told from a static
/// object.
///
/// Between its observations, and a little before and after, an object is where its motion leads.
/// Tracks of fragments of one vehicle are merged (merge_fragments). Those of rails are left out
/// (is_rail).
///
/// Detections are read three times in order of time and once backward, those of merged tracks once
/// more, and are not kept. What stays in memory are the tracks, without their surfaces.
///
/// @param times        of the sweeps [s]
/// @param buffer_size  so many sweeps are in memory at once, at least 1, and those within the
/// window
///   of dynamic voxels around them; results do not depend on it
/// @param progress     told after each sweep of each step
/// @return track 1, 2, ...
std::vector<TrackedObject> track_objects(
    const ReadDetections& read, const std::vector<double>& times, int threads,
    const TakeSweep& take, std::size_t buffer_size, const TrackingOptions& options = {},
    const TellProgress& progress = [](double) {});

}  // namespace docdepth
