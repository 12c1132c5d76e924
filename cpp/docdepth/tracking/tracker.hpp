// Follows objects from sweep to sweep.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <vector>

#include "docdepth/tracking/matching.hpp"
#include "docdepth/tracking/track.hpp"

namespace docdepth {

/// Gives the detections of a sweep. It is called from the thread that tracks, and may be asked for
/// a sweep several times.
using ReadDetections = std::function<std::shared_ptr<const Detections>(std::size_t sweep)>;

/// Takes the share of the work that is done, ascending up to 1. It is called from the thread that
/// tracks.
using TellProgress = std::function<void(double share)>;

/// What tracking depends on. Beyond the paper.
struct TrackingOptions {
  /// A track is dynamic if it is transient in this many sweeps,
  int min_detections = 3;
  /// and if it went this far [m].
  float min_distance = 1.0f;
  /// A moving object that is hidden for longer is lost [s].
  float max_gap = 1.0f;
  /// The same for a standing object [s].
  float max_gap_standing = 5.0f;
  /// The extent of an object, and the dynamic voxels of a sweep, come from the sweeps within this
  /// time [s]. 0: only detections that belong to a track become dynamic.
  double window = 0.3;
  MatchOptions matching{};
};

/// Follow the objects that the votes call dynamic, forward in time and then backward.
///
/// An object of the next sweep belongs to a track if it falls onto the track's shifted samples,
/// unless together they are larger than the object ever looked. These samples are those of the last
/// two sweeps, since a sensor of few beams or a rosette sees other parts in each sweep. So an
/// object is followed to where it stands before or after, and to where no key frame looked. After a
/// gap it does not go on with what stood there already. Two tracks become one where the later,
/// followed backward, meets the end of the earlier. What the LiDAR sees of its own vehicle is not
/// tracked (EgoBody).
///
/// @param times     of the sweeps [s]
/// @param progress  told after each sweep
std::vector<Track> follow_objects(
    const ReadDetections& read, const std::vector<double>& times, const TrackingOptions& options,
    const TellProgress& progress = [](double) {});

}  // namespace docdepth
