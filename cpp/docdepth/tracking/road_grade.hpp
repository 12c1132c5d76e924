// How high an object stands, and whether it goes up or down.
#pragma once

#include <cmath>

#include "docdepth/detections/ground_grid.hpp"
#include "docdepth/tracking/motion_filter.hpp"

namespace docdepth {

/// The height of the ground under a track, and how it goes on: on a slope an object rises or falls
/// from sweep to sweep. The points of the object itself tell little of that, as rings leave gaps.
class RoadGrade {
 public:
  /// Take the ground under the next observation, forward or backward in time.
  void add(double time, const GroundHeight& ground) {
    if (!std::isfinite(ground.deviation)) return;
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

}  // namespace docdepth
