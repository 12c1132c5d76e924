#include "docdepth/tracking/motion_filter.hpp"

#include <Eigen/Cholesky>
#include <cmath>

namespace docdepth {
namespace {

/// Measurements farther from the expected place are outliers [standard deviations].
constexpr double kGate = 4;

using Matrix3 = Eigen::Matrix3d;

}  // namespace

void MotionFilter::start(const MeasuredPosition& at, const Eigen::Vector3d& velocity,
                         double deviation) {
  time_ = at.time;
  mean_ << at.position, velocity, Eigen::Vector3d::Zero();
  covariance_.setZero();
  covariance_.topLeftCorner<3, 3>() = at.covariance;
  const Eigen::Vector3d level_or_up(1, 1, kSteepest * kSteepest);
  covariance_.diagonal().segment<3>(3) = deviation * deviation * level_or_up;
  covariance_.diagonal().tail<3>() = kStrongest * kStrongest * level_or_up;
}

MotionFilter::Matrix9 MotionFilter::transition(double t) {
  Matrix9 matrix = Matrix9::Identity();
  matrix.block<3, 3>(0, 3) = matrix.block<3, 3>(3, 6) = t * Matrix3::Identity();
  matrix.block<3, 3>(0, 6) = t * t / 2 * Matrix3::Identity();
  return matrix;
}

void MotionFilter::predict(double time, const Eigen::Vector3d& change) {
  const double t = time - time_, d = std::fabs(t);
  const Matrix9 matrix = transition(t);
  const Matrix3 density = change.cwiseAbs2().asDiagonal();
  // Of a step back in time the odd powers change their sign.
  const double shares[3][3] = {{d * t * t * t * t / 20, t * t * t * d / 8, d * t * t / 6},
                               {t * t * t * d / 8, d * t * t / 3, t * d / 2},
                               {d * t * t / 6, t * d / 2, d}};
  mean_ = matrix * mean_;
  covariance_ = matrix * covariance_ * matrix.transpose();
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) covariance_.block<3, 3>(3 * i, 3 * j) += shares[i][j] * density;
  time_ = time;
}

void MotionFilter::update(const MeasuredPosition& seen) {
  const Matrix3 innovation = covariance() + seen.covariance;
  const Eigen::Matrix<double, 9, 3> gain =
      innovation.ldlt().solve(covariance_.topRows<3>()).transpose();
  Matrix9 left = Matrix9::Identity();
  left.leftCols<3>() -= gain;
  mean_ += gain * (seen.position - position());
  // Joseph's form keeps the covariance positive.
  covariance_ = left * covariance_ * left.transpose() + gain * seen.covariance * gain.transpose();
}

void MotionFilter::update_height(double height, double deviation) {
  const Vector9 column = covariance_.col(2);
  const double variance = column(2) + deviation * deviation;
  mean_ += column * ((height - mean_(2)) / variance);
  covariance_ -= column * column.transpose() / variance;
}

bool MotionFilter::expects(const MeasuredPosition& seen) const {
  const Eigen::Vector3d off = seen.position - position();
  return off.dot((covariance() + seen.covariance).ldlt().solve(off)) <= kGate * kGate;
}

void MotionFilter::smooth(const MotionFilter& filtered, const MotionFilter& predicted) {
  const Matrix9 matrix = transition(predicted.time_ - filtered.time_);
  const Matrix9 gain =
      predicted.covariance_.ldlt().solve(matrix * filtered.covariance_).transpose();
  mean_ = filtered.mean_ + gain * (mean_ - predicted.mean_);
  covariance_ =
      filtered.covariance_ + gain * (covariance_ - predicted.covariance_) * gain.transpose();
  time_ = filtered.time_;
}

std::vector<Motion> smooth_positions(const std::vector<MeasuredPosition>& measured,
                                     const std::vector<Eigen::Vector3d>& changes) {
  std::vector<MotionFilter> filtered, predicted;
  MotionFilter filter;
  filter.start({measured.front().time, measured.front().position, Eigen::Matrix3d::Identity()},
               Eigen::Vector3d::Zero(), MotionFilter::kFastest);
  for (std::size_t k = 0; k < measured.size(); ++k) {
    filter.predict(measured[k].time, changes[k]);
    predicted.push_back(filter);
    filter.update(measured[k]);
    filtered.push_back(filter);
  }
  std::vector<Motion> motions(measured.size());
  for (std::size_t k = measured.size(); k-- > 0;) {
    if (k + 1 < measured.size()) filter.smooth(filtered[k], predicted[k + 1]);
    motions[k] = {filter.position(), filter.velocity(), filter.covariance()};
  }
  return motions;
}

}  // namespace docdepth
