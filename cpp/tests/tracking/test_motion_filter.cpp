#include <doctest/doctest.h>

#include <cmath>

#include "docdepth/tracking/motion_filter.hpp"

using namespace docdepth;

namespace {

const Eigen::Vector3d kNoChange = Eigen::Vector3d::Zero();

MeasuredPosition measured(double time, const Eigen::Vector3d& position, double variance) {
  return {time, position, variance * Eigen::Matrix3d::Identity()};
}

MotionFilter started(double deviation) {
  MotionFilter filter;
  filter.start(measured(1, {1, 2, 3}, 0.04), {5, -4, 1}, deviation);
  return filter;
}

}  // namespace

TEST_CASE("a motion goes on as fast, forward and backward, and becomes less certain") {
  for (const double dt : {0.5, -0.5}) {
    MotionFilter filter = started(2);
    filter.predict(1 + dt, kNoChange);
    CHECK((filter.position() - Eigen::Vector3d(1 + 5 * dt, 2 - 4 * dt, 3 + dt)).norm() < 1e-12);
    // Of the position, the velocity and the acceleration at the start.
    const double steep = MotionFilter::kSteepest * MotionFilter::kSteepest;
    const double moved = 4 * dt * dt + 9 * std::pow(dt, 4) / 4;
    CHECK(filter.covariance()(0, 0) == doctest::Approx(0.04 + moved));
    CHECK(filter.covariance()(2, 2) == doctest::Approx(0.04 + steep * moved));
    CHECK(filter.covariance()(0, 1) == 0);
  }
}

TEST_CASE("an acceleration that is a random walk adds the variance of its double integral") {
  for (const double dt : {0.4, -0.4}) {
    MotionFilter with = started(1), without = started(1);
    with.predict(1 + dt, {3, 2, 0});
    without.predict(1 + dt, kNoChange);
    const Eigen::Matrix3d added = with.covariance() - without.covariance();
    CHECK(added(0, 0) == doctest::Approx(9 * std::pow(0.4, 5) / 20));
    CHECK(added(1, 1) == doctest::Approx(4 * std::pow(0.4, 5) / 20));
    CHECK(added(2, 2) == 0);
  }
}

TEST_CASE("two steps are one step") {
  MotionFilter once = started(1), twice = started(1);
  const Eigen::Vector3d change(3, 3, 0.3);
  once.predict(1.7, change);
  twice.predict(1.2, change);
  twice.predict(1.7, change);
  CHECK((once.position() - twice.position()).norm() < 1e-12);
  CHECK((once.covariance() - twice.covariance()).norm() < 1e-12);
}

TEST_CASE("a measurement counts by its variance") {
  MotionFilter filter = started(0);
  filter.update(measured(1, {2, 2, 7}, 0.12));  // three times that of the filter
  CHECK((filter.position() - Eigen::Vector3d(1.25, 2, 4)).norm() < 1e-12);
  CHECK(filter.covariance()(0, 0) == doctest::Approx(0.03));
}

TEST_CASE("a height is a measurement of z alone") {
  MotionFilter filter = started(2), same = started(2);
  filter.predict(1.3, kNoChange);
  same.predict(1.3, kNoChange);
  const double before = filter.covariance()(0, 0);
  filter.update_height(9, 0.5);
  MeasuredPosition vague = measured(1.3, same.position(), 1e12);
  vague.position.z() = 9;
  vague.covariance(2, 2) = 0.25;
  same.update(vague);
  CHECK((filter.position() - same.position()).norm() < 1e-6);
  CHECK((filter.velocity() - same.velocity()).norm() < 1e-6);
  CHECK(filter.covariance()(0, 0) == before);
  CHECK(filter.covariance()(2, 2) == doctest::Approx(same.covariance()(2, 2)));
}

TEST_CASE("a measurement is expected within four standard deviations of both") {
  const MotionFilter filter = started(1);
  const auto expects = [&](double off) {
    return filter.expects(measured(1, {1 + off, 2, 3}, 0.05));
  };
  CHECK(expects(4 * 0.3 - 1e-6));
  CHECK(!expects(4 * 0.3 + 1e-6));
  CHECK(!expects(-4 * 0.3 - 1e-6));
}
