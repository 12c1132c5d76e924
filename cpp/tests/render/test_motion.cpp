#include <doctest/doctest.h>

#include <cmath>
#include <random>

#include "docdepth/render/motion.hpp"
#include "docdepth/render/velocity_estimator.hpp"

using namespace docdepth;

namespace {

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

}  // namespace

TEST_CASE("objects are separated and matched, none with another one") {
  // The corner of a car and a pedestrian next to it, with different velocities.
  std::mt19937 random(6);
  std::uniform_real_distribution<float> along(0, 4), across(0, 1.7f), up(-1.5f, 0), person(0, 0.4f);
  const auto scene = [&](Eigen::Vector3f car, Eigen::Vector3f walker) {
    Matrix points(900, 3);
    for (int i = 0; i < 800; ++i)
      points.row(i) = (i % 4 ? Eigen::Vector3f(10 + along(random), 3, up(random))
                             : Eigen::Vector3f(10, 3 + across(random), up(random))) +
                      car;
    for (int i = 800; i < 900; ++i)
      points.row(i) =
          Eigen::Vector3f(12 + person(random), 1.2f + person(random), up(random)) + walker;
    return points;
  };
  const std::vector<std::uint16_t> moving(900, 100);
  const std::vector<float> time_offset(900, 0.02f), later(900, 0.03f);
  const DynamicObjects objects =
      find_dynamic_objects(scene({0, 0, 0}, {0, 0, 0}), moving.data(), time_offset.data());
  REQUIRE(objects.samples.size() == 2);
  CHECK(objects.owner[0] == 1);
  CHECK(objects.owner[899] == 2);
  CHECK(objects.time_offset[0] == doctest::Approx(0.02));
  const Matrix after = scene({3, -0.5f, 0}, {0.1f, 0.1f, 0});
  Pose T = Pose::Identity();  // the sensor, too, has moved
  T.rotate(Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitZ())).translate(Eigen::Vector3d(1, 2, 0));
  Matrix seen = after;
  for (int i = 0; i < 900; ++i)
    seen.row(i) = (T.inverse() * after.row(i).transpose().cast<double>()).cast<float>();
  const RelativeMotion motion{T, 0.1f, 50};
  const DynamicObjects other = find_dynamic_objects(seen, moving.data(), later.data());
  const auto one = match_velocities(objects, other, motion, 1);
  const auto two = match_velocities(objects, other, motion, 2);
  CHECK((one[0] * 0.11f - Eigen::Vector3f(3, -0.5f, 0)).norm() < 0.08f);
  CHECK((one[1] * 0.11f - Eigen::Vector3f(0.1f, 0.1f, 0)).norm() < 0.08f);
  CHECK((one[0] == two[0] && one[1] == two[1]));
  for (const auto& velocity : match_velocities(objects, DynamicObjects{}, motion, 1))
    CHECK(velocity.isZero());
  for (const auto& velocity : match_velocities(objects, other, {T, 0, 50}, 1))
    CHECK(velocity.isZero());
}

TEST_CASE("two parts of a car behind a post get the velocity that rays verify") {
  // The side of the car, 10 m ahead, moves 8 m/s to the left. The post hides its middle.
  const auto sweep = [](float from_middle, std::vector<std::uint16_t>& classid) {
    Matrix points(0, 3);
    classid.clear();
    for (float up = -0.2f; up < 0.2f; up += 0.02f)
      for (float side = -0.5f; side < 0.5f; side += 0.005f) {
        const bool post = std::fabs(side) < 0.08f;
        const bool car = std::fabs(side * 10 - from_middle) < 2 && std::fabs(up) < 0.1f;
        classid.push_back(car && !post ? 100 : 50);
        points.conservativeResize(points.rows() + 1, 3);
        points.row(points.rows() - 1) = Eigen::Vector3f(1, side, up) * (post  ? 5.0f
                                                                        : car ? 10.0f
                                                                              : 20.0f);
      }
    return points;
  };
  std::vector<std::uint16_t> classid;
  const Matrix here = sweep(0, classid);
  const DynamicObjects objects = find_dynamic_objects(here, classid.data(), nullptr);
  REQUIRE(objects.samples.size() == 2);
  std::vector<Rays> rays;
  for (const float since : {-0.1f, 0.1f, 0.2f}) {
    const Matrix there = sweep(8 * since, classid);
    rays.emplace_back(there, std::vector<Eigen::Vector3f>(there.rows(), {-1, 0, 0}));
  }
  const std::vector<VisibilitySweep> visibility_sweeps{{&rays[0], {Pose::Identity(), -0.1f, 50}},
                                                       {&rays[1], {Pose::Identity(), 0.1f, 50}},
                                                       {&rays[2], {Pose::Identity(), 0.2f, 50}}};
  const Eigen::Vector3f still = Eigen::Vector3f::Zero(), slow(0, 2, 0), exact(0, 8, 0);
  VelocityEstimator estimator(objects, visibility_sweeps, {1, 1}, 2);
  estimator.propose({slow, exact});
  CHECK(estimator.unverified()[0] == 1);
  CHECK((estimator.velocities() == std::vector<Eigen::Vector3f>{slow, exact}));
  SUBCASE("another sweep matches better") {
    estimator.propose({exact, slow});
    CHECK((estimator.velocities() == std::vector<Eigen::Vector3f>{exact, exact}));
    estimator.propose({slow, still});
    CHECK((estimator.velocities() == std::vector<Eigen::Vector3f>{exact, exact}));
  }
  SUBCASE("the other part has the right velocity") {
    estimator.propose_neighbors();
    CHECK((estimator.velocities() == std::vector<Eigen::Vector3f>{exact, exact}));
  }
  SUBCASE("unwanted objects are not verified, and without rays every velocity is") {
    const std::vector<VisibilitySweep> no_sweeps;
    VelocityEstimator none(objects, visibility_sweeps, {0, 0}, 1),
        blind(objects, no_sweeps, {1, 1}, 1);
    none.propose({exact, exact}), blind.propose({slow, exact}), blind.propose_neighbors();
    CHECK((none.velocities() == std::vector<Eigen::Vector3f>{still, still}));
    CHECK((blind.velocities() == std::vector<Eigen::Vector3f>{slow, exact}));
  }
}

TEST_CASE("a hidden object is matched with no other one, but parts of one object are") {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> share(0, 1);
  const auto add = [&](Matrix& points, int count, Eigen::Vector3f low, Eigen::Vector3f size) {
    points.conservativeResize(points.rows() + count, 3);
    for (int i = 0; i < count; ++i)
      for (int axis = 0; axis < 3; ++axis)
        points(points.rows() - 1 - i, axis) = low[axis] + size[axis] * share(random);
  };
  const auto found = [](const Matrix& points) {
    return find_dynamic_objects(points, std::vector<std::uint16_t>(points.rows(), 100).data(),
                                nullptr);
  };
  const RelativeMotion motion{Pose::Identity(), 0.1f, 50};
  const Eigen::Vector3f person(0.4f, 0.4f, 1.5f);
  SUBCASE("two pedestrians, one of them hidden in the other sweep") {
    Matrix before(0, 3), after(0, 3);
    add(before, 100, {12, 1, -1.5f}, person), add(before, 100, {12, 3.4f, -1.5f}, person);
    add(after, 100, {12, 3.5f, -1.5f}, person);
    const auto velocity = match_velocities(found(before), found(after), motion, 1);
    REQUIRE(velocity.size() == 2);
    CHECK(velocity[0].isZero());
    CHECK((velocity[1] - Eigen::Vector3f(0, 1, 0)).norm() < 0.8f);
    for (const auto& back :
         match_velocities(found(after), found(before), {motion.T_from_to, -0.1f, 50}, 1))
      CHECK((back - velocity[1]).norm() < 0.8f);
  }
  SUBCASE("a car behind a post has two parts") {
    Matrix before(0, 3), after(0, 3);
    const Eigen::Vector3f end(0, 1.7f, 1.4f);
    add(before, 300, {10, 3, -1.5f}, {2.2f, 0, 1.4f});
    add(before, 200, {13.4f, 3, -1.5f}, {1.6f, 0, 1.4f}), add(before, 200, {15, 3, -1.5f}, end);
    add(before, 200, {10, 3, -1.5f}, end), add(after, 200, {11, 3, -1.5f}, end);
    add(after, 700, {11, 3, -1.5f}, {5, 0, 1.4f}), add(after, 200, {16, 3, -1.5f}, end);
    const auto velocity = match_velocities(found(before), found(after), motion, 1);
    REQUIRE(velocity.size() == 2);
    for (const auto& one : velocity) CHECK((one - Eigen::Vector3f(10, 0, 0)).norm() < 0.8f);
  }
}
