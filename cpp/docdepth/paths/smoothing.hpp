// The smoothest motion through measured positions.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "docdepth/tracking/motion_filter.hpp"

namespace docdepth {

struct Motion {
  Eigen::Vector3d position;    ///< [m]
  Eigen::Vector3d velocity;    ///< [m/s]
  Eigen::Matrix3d covariance;  ///< of the position [m^2]
};

/// Position and velocity at each measurement, from all of them: Kalman filter forward, then the
/// smoother of Rauch, Tung and Striebel (1965) backward. The acceleration is a random walk.
///
/// @param measured  ascending in time
/// @param changes   how much each coordinate of the acceleration changes in a second, up to each
///                  measurement [m/s^2]
std::vector<Motion> smooth_positions(const std::vector<MeasuredPosition>& measured,
                                     const std::vector<Eigen::Vector3d>& changes);

}  // namespace docdepth
