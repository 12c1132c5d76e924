// The end at which a track goes on: what was seen of the object last, and how it moves.
#pragma once

#include <cstddef>
#include <memory>

#include "docdepth/detections/detections.hpp"
#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/tracking/road_grade.hpp"
#include "docdepth/tracking/velocity_estimate.hpp"

namespace docdepth {

void append(SampledPoints& samples, const SampledPoints& more);
void append(TimedPoints& samples, const Detection& object);

/// The end at which a track goes on.
struct TrackState {
  int track = 0;
  std::size_t sweep = 0;                           ///< of the last observation
  std::shared_ptr<const Detections> detections{};  ///< of that sweep
  TimedPoints samples{};  ///< of the last two observations: each may see another part
  TimedPoints last{};     ///< of the last observation; times after the stamp of its sweep
  Eigen::Vector3f largest = Eigen::Vector3f::Zero();  ///< size of its objects
  double time = 0;                                    ///< stamp of its sweep [s]
  float offset = 0;  ///< mean time of what was seen last, after the stamp [s]
  VelocityEstimate velocity{};
  RoadGrade grade{};
  float area = 0;             ///< that was seen of it when it was not partly hidden
  SampledPoints neighbors{};  ///< of what touched it but is none of it, where these stand

  /// Take the samples of two observations, at `offset` as fast as the shift between them says, the
  /// older ones moved along.
  void set_samples(const TimedPoints& older, const TimedPoints& newer, const Eigen::Vector3f& shift,
                   double dt);
};

}  // namespace docdepth
