#include <doctest/doctest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>

#include "docdepth/tracking/motion_filter.hpp"

using namespace docdepth;

namespace {

/// Mean and covariance of position, velocity and acceleration at all times, from the normal
/// equations of all measurements, steps and what is known before. One coordinate.
struct LeastSquares {
  Eigen::VectorXd mean;
  Eigen::MatrixXd covariance;

  LeastSquares(const std::vector<double>& times, const std::vector<double>& values,
               const std::vector<double>& variances, double change, double steep) {
    const auto count = Eigen::Index(times.size());
    Eigen::MatrixXd information = Eigen::MatrixXd::Zero(3 * count, 3 * count);
    Eigen::VectorXd vector = Eigen::VectorXd::Zero(3 * count);
    const double first[3] = {1, std::pow(MotionFilter::kFastest * steep, 2),
                             std::pow(MotionFilter::kStrongest * steep, 2)};
    for (int i = 0; i < 3; ++i) information(i, i) += 1 / first[i];
    vector(0) += values[0] / first[0];
    for (Eigen::Index k = 0; k < count; ++k) {
      const auto at = std::size_t(k);
      information(3 * k, 3 * k) += 1 / variances[at];
      vector(3 * k) += values[at] / variances[at];
      if (k == 0) continue;
      const double t = times[at] - times[at - 1];
      Eigen::Matrix3d F;
      F << 1, t, t * t / 2, 0, 1, t, 0, 0, 1;
      Eigen::Matrix3d Q;  // of the integrals of white noise
      Q << std::pow(t, 5) / 20, std::pow(t, 4) / 8, std::pow(t, 3) / 6, std::pow(t, 4) / 8,
          std::pow(t, 3) / 3, t * t / 2, std::pow(t, 3) / 6, t * t / 2, t;
      Eigen::Matrix<double, 3, 6> step;
      step << -F, Eigen::Matrix3d::Identity();
      information.block<6, 6>(3 * k - 3, 3 * k - 3) +=
          step.transpose() * (change * change * Q).inverse() * step;
    }
    mean = information.ldlt().solve(vector);
    covariance = information.inverse();
  }
};

}  // namespace

TEST_CASE("the smoothest motion is that of least squares") {
  const std::vector<double> times{0, 0.1, 0.2, 0.35, 0.4, 0.9};
  const std::vector<double> x{0, 1.1, 1.9, 3.6, 4.1, 8.8}, z{0, 0.1, -0.1, 0.2, 0, 0.1};
  const std::vector<double> variances{0.01, 0.02, 0.01, 0.3, 0.02, 0.05};
  std::vector<MeasuredPosition> measured;
  for (std::size_t k = 0; k < times.size(); ++k)
    measured.push_back({times[k], {x[k], -x[k], z[k]}, variances[k] * Eigen::Matrix3d::Identity()});
  const auto motions = smooth_positions(measured, {times.size(), {3, 3, 0.3}});
  const LeastSquares level(times, x, variances, 3, 1);
  const LeastSquares up(times, z, variances, 0.3, MotionFilter::kSteepest);
  for (std::size_t k = 0; k < times.size(); ++k) {
    const auto row = Eigen::Index(3 * k);
    CHECK(motions[k].position.x() == doctest::Approx(level.mean(row)).epsilon(1e-6));
    CHECK(motions[k].position.y() == doctest::Approx(-level.mean(row)).epsilon(1e-6));
    CHECK(motions[k].velocity.x() == doctest::Approx(level.mean(row + 1)).epsilon(1e-6));
    CHECK(motions[k].covariance(0, 0) == doctest::Approx(level.covariance(row, row)).epsilon(1e-6));
    CHECK(motions[k].position.z() == doctest::Approx(up.mean(row)).epsilon(1e-6));
    CHECK(motions[k].covariance(2, 2) == doctest::Approx(up.covariance(row, row)).epsilon(1e-6));
  }
}
