// The velocity of a track, as its shifts tell it.
#pragma once

#include <Eigen/Core>
#include <cmath>

#include "docdepth/tracking/constants.hpp"

namespace docdepth {

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

}  // namespace docdepth
