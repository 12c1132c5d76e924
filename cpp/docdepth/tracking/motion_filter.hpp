// A motion filtered from measured positions, and the smoothest one through them.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace docdepth {

struct MeasuredPosition {
  double time;                 ///< [s]
  Eigen::Vector3d position;    ///< [m]
  Eigen::Matrix3d covariance;  ///< of it [m^2]
};

/// What is known of a motion at a time: the acceleration is a random walk.
class MotionFilter {
 public:
  /// Before anything is known of a road user: its speed [m/s] and acceleration [m/s^2].
  static constexpr double kFastest = 20;
  static constexpr double kStrongest = 3;
  /// How much the vertical acceleration changes in a second [m/s^2]: roads bend far less up and
  /// down than sideways.
  static constexpr double kVerticalChange = 0.3;
  /// No road is steeper [rad]: 20 degrees.
  static constexpr double kSteepest = 0.35;

  /// Begin at a position with a velocity that is known within `deviation` [m/s]; upward within
  /// kSteepest of that.
  void start(const MeasuredPosition& at, const Eigen::Vector3d& velocity, double deviation);
  /// Go to another time [s], earlier ones, too.
  /// @param change  how much each coordinate of the acceleration changes in a second [m/s^2]
  void predict(double time, const Eigen::Vector3d& change);
  /// Take a measurement at the current time.
  void update(const MeasuredPosition& seen);
  /// Take a height, which is known within `deviation` [m].
  void update_height(double height, double deviation);
  /// Whether a measurement at the current time is one that can be expected.
  bool expects(const MeasuredPosition& seen) const;
  /// Step back in time from the next measurement, at which this is the smoothed motion.
  /// @param filtered   after the measurement to which the step leads
  /// @param predicted  of the next measurement, before it was taken
  void smooth(const MotionFilter& filtered, const MotionFilter& predicted);

  Eigen::Vector3d position() const { return mean_.head<3>(); }
  Eigen::Vector3d velocity() const { return mean_.segment<3>(3); }
  Eigen::Matrix3d covariance() const { return covariance_.topLeftCorner<3, 3>(); }

 private:
  using Vector9 = Eigen::Matrix<double, 9, 1>;  ///< position, velocity, acceleration
  using Matrix9 = Eigen::Matrix<double, 9, 9>;
  static Matrix9 transition(double dt);

  double time_ = 0;
  Vector9 mean_ = Vector9::Zero();
  Matrix9 covariance_ = Matrix9::Zero();
};

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
