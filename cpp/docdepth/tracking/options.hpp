// What tracking depends on. Beyond the paper.
#pragma once

#include "docdepth/tracking/matching.hpp"

namespace docdepth {

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

}  // namespace docdepth
