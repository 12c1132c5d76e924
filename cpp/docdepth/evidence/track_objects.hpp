// Tracking: an object that moves at one time is dynamic also while it stands, and where no key
// frame looked. Beyond the paper.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "docdepth/detections/detections.hpp"
#include "docdepth/paths/track_path.hpp"
#include "docdepth/tracking/detection_window.hpp"
#include "docdepth/tracking/parameters.hpp"

namespace docdepth {

/// A detection of a sweep that belongs to a track.
struct Member {
  std::uint32_t first;  ///< row of its first point
  std::uint32_t track;  ///< number of the track, from 1
  bool dynamic;         ///< whether the track makes it dynamic
};

/// Where an object that moves at some time is in a sweep, detected or not.
struct TrackBox {
  std::uint32_t track;
  bool moving;  ///< at the time of the sweep
  OrientedBox box;
};

/// The tracks in one sweep.
struct TrackedSweep {
  std::vector<Member> members;  ///< by their rows
  std::vector<TrackBox> boxes;
  std::vector<std::uint64_t> voxels;  ///< dynamic voxels, ascending (dynamic_voxels)

  /// Whether a track makes the object with that first point dynamic.
  bool claims(std::uint32_t first) const;
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
  std::vector<Place> places;
  Eigen::Vector3f size;  ///< length, width and height [m]
  bool rigid;
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
/// Tracks of parts of one vehicle are joined (join_parts).
///
/// Detections are read three times in order of time and once backward, those of joined tracks once
/// more, and are not kept. What stays in memory are the tracks, without their surfaces.
///
/// @param times  of the sweeps [s]
/// @param held   so many sweeps are held at once, at least 1, and those within the window of
/// dynamic
///               voxels around them; results do not depend on it
/// @return track 1, 2, ...
std::vector<TrackedObject> track_objects(const ReadDetections& read,
                                         const std::vector<double>& times,
                                         const TrackParameters& parameters, int threads,
                                         const TakeSweep& take, std::size_t held);

}  // namespace docdepth
