// The smoothest motion through measured positions.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace docdepth {

struct MeasuredPosition {
  double time;                 ///< [s]
  Eigen::Vector3d position;    ///< [m]
  Eigen::Matrix3d covariance;  ///< of it [m^2]
};

struct Motion {
  Eigen::Vector3d position;  ///< [m]
  Eigen::Vector3d velocity;  ///< [m/s]
};

/// Position and velocity at each measurement, from all of them: Kalman filter forward, then the
/// smoother of Rauch, Tung and Striebel (1965) backward. The acceleration is a random walk.
///
/// @param measured      ascending in time
/// @param acceleration  how much each coordinate of the acceleration changes in a second [m/s^2]
std::vector<Motion> smooth_positions(const std::vector<MeasuredPosition>& measured,
                                     const Eigen::Vector3d& acceleration);

}  // namespace docdepth
