// Where a track goes on in another sweep.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/detections/detections.hpp"
#include "docdepth/tracking/track_end.hpp"

namespace docdepth {

/// The continuation of a track in a sweep.
struct Match {
  float score = 0;  ///< 0 if there is none
  /// How far it went between two moments as far apart as the stamps of the two sweeps [m].
  Eigen::Vector3f shift = Eigen::Vector3f::Zero();
  std::vector<std::uint32_t> objects;
  TimedPoints samples;
  Extent box;
  Eigen::Vector3f largest;
  bool hidden = false;  ///< partly, by something nearer
  float error = 0;      ///< how wrong the shift may be [m]
  float area = 0;       ///< of its objects
  SampledPoints neighbors;
};

/// The best match of a track in a sweep: the detections onto which its samples fall.
///
/// A sweep takes a tenth of a second, and one petal of a rosette sees a car on a motorway metres
/// behind where another one does. So all samples are compared where they were at one time after the
/// stamp of their sweep: that at which the track was seen last.
///
/// @param free       of each detection, whether the track may take it
/// @param time       stamp of the sweep [s]
/// @param max_speed  of a track whose speed is not known yet [m/s]
Match find_match(const TrackEnd& end, const Detections& seen, const std::vector<bool>& free,
                 double time, float max_speed);

/// Whether a box may be the same object as one that was seen with another size.
bool could_match(const Extent& box, const Eigen::Vector3f& size);

}  // namespace docdepth
