// An object followed from sweep to sweep, and the end at which it is followed on.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "docdepth/detections/detections.hpp"
#include "docdepth/tracking/constants.hpp"
#include "docdepth/tracking/motion_filter.hpp"

namespace docdepth {

/// What one sweep saw of a track.
struct TrackObservation {
  std::size_t sweep = 0;
  std::vector<std::uint32_t> detections{};  ///< indices of those of the sweep
  Extent box{};                             ///< around them
  /// How far it went between the stamps of the last observation and of this one, by its samples
  /// [m].
  Eigen::Vector3f shift = Eigen::Vector3f::Zero();
  float shift_error = 0;      ///< how wrong that may be [m]
  bool is_transient = false;  ///< whether most of its points are of transient detections
  bool is_dynamic = false;    ///< whether most of its points are of dynamic detections
  float area = 0;             ///< of its points (Detection)
  float transient_area = 0;   ///< of those that are transient
  float free_area = 0;        ///< of those whose place was free
  float porous_area = 0;      ///< of those whose place was hit and passed in turn
  std::uint32_t points = 0;   ///< of its detections
  double time_offset = 0;     ///< mean time of these points [s after the sweep's stamp]
  GroundHeight ground{};      ///< under the detection of most points

  bool is_mostly_transient() const { return transient_area >= kMinFreeShare * area; }
  /// What of its places was free at some time, though perhaps occupied again soon.
  float found_free_area() const { return std::max(transient_area, free_area + porous_area); }
};

/// Some detections of a sweep as an observation, without a shift.
TrackObservation observe(std::size_t sweep, const Detections& detections,
                         std::vector<std::uint32_t> chosen);

struct Track {
  std::vector<TrackObservation> observations;  ///< ascending in time
  int transient_count = 0;                     ///< how many of them are transient
};

/// The mean of the shifts of a track, the last ones most.
struct VelocityEstimate {
  Eigen::Vector3f mean = Eigen::Vector3f::Zero();  ///< [m/s]
  float error = 0;                                 ///< of it [m/s]
  bool is_known = false;

  /// @param shift_error  how wrong the shift may be [m]
  void add(const Eigen::Vector3f& shift, double dt, float shift_error) {
    const auto t = static_cast<float>(dt);
    const Eigen::Vector3f measured = shift / t;
    const float its_error = shift_error / std::fabs(t);
    mean = is_known ? Eigen::Vector3f(0.5f * mean + 0.5f * measured) : measured;
    error = is_known ? 0.5f * error + 0.5f * its_error : its_error;
    is_known = true;
  }
  /// Whether it can go so far within a duration [s]: no road user changes its speed faster.
  bool allows(const Eigen::Vector3f& shift, double dt, float shift_error) const {
    if (!is_known) return true;
    const auto t = static_cast<float>(std::fabs(dt));
    const float most = kMaxAcceleration * t * t / 2 + error * t + shift_error;
    return (shift - mean * float(dt)).head<2>().norm() <= most;
  }
  bool stands() const { return mean.norm() < kStanding; }
};

/// The height of the ground under a track, and how it goes on: on a slope an object rises or falls
/// from sweep to sweep. The points of the object itself tell little of that, as rings leave gaps.
class RoadGrade {
 public:
  /// Take the ground under the next observation, forward or backward in time.
  void add(double time, const GroundHeight& ground) {
    if (!ground.is_known()) return;
    if (known_) {
      height_.predict(time, kChange);
      height_.update_height(ground.value, ground.deviation);
    } else {
      const double variance = ground.deviation * ground.deviation;
      height_.start({time, {0, 0, ground.value}, variance * Eigen::Matrix3d::Identity()},
                    Eigen::Vector3d::Zero(), MotionFilter::kFastest);
      known_ = true;
    }
  }

  /// How much higher the object is at another time [m]; 0 if that is no more than its error.
  /// @param ground  that was seen there; of infinite deviation if none was
  float rise(double time, const GroundHeight& ground) const {
    if (!known_) return 0;
    RoadGrade there = *this;
    there.height_.predict(time, kChange);
    there.add(time, ground);
    const auto rise = float(there.height_.position().z() - height_.position().z());
    return std::fabs(rise) > std::sqrt(there.height_.covariance()(2, 2)) ? rise : 0;
  }

 private:
  inline static const Eigen::Vector3d kChange{0, 0, MotionFilter::kVerticalChange};

  MotionFilter height_;  ///< of which the vertical part is used
  bool known_ = false;
};

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
  SampledPoints neighbors{};  ///< of what touched it but is none of it, where these stand

  /// Take the samples of two observations, at `offset` as fast as the shift between them says, the
  /// older ones moved along.
  void set_samples(const TimedPoints& older, const TimedPoints& newer, const Eigen::Vector3f& shift,
                   double dt);
};

}  // namespace docdepth
