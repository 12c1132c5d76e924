#include "docdepth/objects/smoothing.hpp"

#include <Eigen/Cholesky>

#include "docdepth/objects/constants.hpp"

namespace docdepth {
namespace {

using Matrix3 = Eigen::Matrix3d;
using Matrix9 = Eigen::Matrix<double, 9, 9>;
using Vector9 = Eigen::Matrix<double, 9, 1>;  // position, velocity, acceleration

struct State {
  Vector9 mean;
  Matrix9 covariance;
};

/// How a state changes within a duration.
struct Transition {
  Matrix9 matrix = Matrix9::Identity(), noise = Matrix9::Zero();

  Transition(double t, const Eigen::Vector3d& acceleration) {
    const Matrix3 density = acceleration.cwiseAbs2().asDiagonal();
    matrix.block<3, 3>(0, 3) = matrix.block<3, 3>(3, 6) = t * Matrix3::Identity();
    matrix.block<3, 3>(0, 6) = t * t / 2 * Matrix3::Identity();
    const double shares[3][3] = {{t * t * t * t * t / 20, t * t * t * t / 8, t * t * t / 6},
                                 {t * t * t * t / 8, t * t * t / 3, t * t / 2},
                                 {t * t * t / 6, t * t / 2, t}};
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) noise.block<3, 3>(3 * i, 3 * j) = shares[i][j] * density;
  }

  State apply(const State& s) const {
    return {matrix * s.mean, matrix * s.covariance * matrix.transpose() + noise};
  }
};

State update(const State& predicted, const MeasuredPosition& seen) {
  const Matrix3 innovation = predicted.covariance.topLeftCorner<3, 3>() + seen.covariance;
  const Eigen::Matrix<double, 9, 3> gain =
      innovation.ldlt().solve(predicted.covariance.topRows<3>()).transpose();
  Matrix9 left = Matrix9::Identity();
  left.leftCols<3>() -= gain;
  // Joseph's form keeps the covariance positive.
  return {predicted.mean + gain * (seen.position - predicted.mean.head<3>()),
          left * predicted.covariance * left.transpose() +
              gain * seen.covariance * gain.transpose()};
}

}  // namespace

std::vector<Motion> smooth_positions(const std::vector<MeasuredPosition>& measured,
                                     const Eigen::Vector3d& acceleration) {
  std::vector<State> filtered, predicted;
  std::vector<Transition> transitions;
  State state{Vector9::Zero(), Matrix9::Zero()};
  state.mean.head<3>() = measured.front().position;
  state.covariance.diagonal() << Eigen::Vector3d::Constant(1),
      Eigen::Vector3d::Constant(kFastest * kFastest),
      Eigen::Vector3d::Constant(kStrongest * kStrongest);
  for (std::size_t k = 0; k < measured.size(); ++k) {
    if (k > 0) {
      transitions.emplace_back(measured[k].time - measured[k - 1].time, acceleration);
      state = transitions.back().apply(state);
    }
    predicted.push_back(state);
    state = update(state, measured[k]);
    filtered.push_back(state);
  }
  std::vector<Motion> motions(measured.size());
  for (std::size_t k = measured.size(); k-- > 0;) {
    if (k + 1 < measured.size()) {
      const State &before = filtered[k], &expected = predicted[k + 1];
      const Matrix9 gain = expected.covariance.ldlt()
                               .solve(transitions[k].matrix * before.covariance)
                               .transpose();
      state = {before.mean + gain * (state.mean - expected.mean),
               before.covariance +
                   gain * (state.covariance - expected.covariance) * gain.transpose()};
    }
    motions[k] = {state.mean.head<3>(), state.mean.segment<3>(3)};
  }
  return motions;
}

}  // namespace docdepth
