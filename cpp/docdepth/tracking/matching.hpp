// Where a track goes on in another sweep.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "docdepth/detections/detections.hpp"
#include "docdepth/tracking/detection_index.hpp"
#include "docdepth/tracking/track.hpp"

namespace docdepth {

/// The continuation of a track in a sweep.
struct Match {
  float score = 0;  ///< 0 if there is none
  /// How far it went between two moments as far apart as the stamps of the two sweeps [m].
  Eigen::Vector3f shift = Eigen::Vector3f::Zero();
  std::vector<std::uint32_t> detections;  ///< indices of those of the sweep
  TimedPoints samples;
  Extent box{};
  Eigen::Vector3f largest = Eigen::Vector3f::Zero();
  bool hidden = false;  ///< partly, by something nearer
  float error = 0;      ///< how wrong the shift may be [m]
  SampledPoints neighbors;
};

struct MatchOptions {
  /// Fastest road user [m/s]: a track whose speed is not known yet reaches so far.
  float max_speed = 40.0f;
  /// Samples match exactly within this horizontal distance [m]: they are this far apart at most.
  float level_distance = 0.2f;
  /// Weight of the samples that match beside those that match exactly: it decides between few.
  float near_weight = 0.1f;
  /// Two objects match if the product of their matched shares is at least this.
  float min_share = 0.4f;
  /// How wrong a shift may be [m];
  float shift_error = 0.15f;
  /// far away as much as rays are apart [rad]: 0.3 degrees.
  float ray_spacing = 0.005f;
};

/// The best match of a track in a sweep: the detections onto which its samples fall.
///
/// A sweep takes a tenth of a second, and one petal of a rosette sees a car on a motorway metres
/// behind where another one does. So all samples are compared where they were at one time after the
/// stamp of their sweep: that at which the track was seen last.
///
/// @param is_free  whether the track may take a detection
/// @param time     stamp of the sweep [s]
Match find_match(const TrackState& state, const DetectionIndex& seen,
                 const std::function<bool(std::uint32_t)>& is_free, double time,
                 const MatchOptions& options);

/// Whether a box may be the same object as one that was seen with another size.
bool could_match(const Extent& box, const Eigen::Vector3f& size);

}  // namespace docdepth
