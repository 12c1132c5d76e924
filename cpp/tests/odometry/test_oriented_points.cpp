#include <doctest/doctest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <numeric>
#include <random>
#include <vector>

#include "docdepth/odometry/oriented_points.hpp"

using namespace docdepth;

namespace {

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

Matrix cloud(int count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> any(-5, 5);
  Matrix points(count, 3);
  for (int i = 0; i < count; ++i)
    for (int axis = 0; axis < 3; ++axis) points(i, axis) = any(random);
  return points;
}

/// The normal of a point by a look at all others.
Eigen::Vector3d plain_normal(const Matrix& points, Eigen::Index i, int neighbors) {
  std::vector<Eigen::Index> rows(static_cast<std::size_t>(points.rows()));
  std::iota(rows.begin(), rows.end(), 0);
  std::sort(rows.begin(), rows.end(), [&](Eigen::Index a, Eigen::Index b) {
    return (points.row(a) - points.row(i)).squaredNorm() <
           (points.row(b) - points.row(i)).squaredNorm();
  });
  Eigen::MatrixXd near(neighbors, 3);
  for (int k = 0; k < neighbors; ++k) near.row(k) = points.row(rows[k]).cast<double>();
  near.rowwise() -= near.colwise().mean().eval();
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(near.transpose() * near)
      .eigenvectors()
      .col(0);
}

}  // namespace

TEST_CASE("normals are those of the nearest points, whatever the threads") {
  Matrix points = cloud(600, 4);
  points.col(2) *= 0.02f;  // a rough plane
  points.rowwise() += Eigen::RowVector3f(900, -700, -30);
  const OrientedPoints one = with_normals(points, 15, 1);
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const Eigen::Vector3d expected = plain_normal(points, i, 15);
    CHECK(std::abs(expected.dot(one.normals[std::size_t(i)].cast<double>())) > 1 - 1e-5);
  }
  const OrientedPoints four = with_normals(points, 15, 4);
  CHECK(one.normals == four.normals);
}

TEST_CASE("where there are fewer points than neighbours, all of them form the plane") {
  Matrix points = cloud(9, 7);
  points.col(1) *= 0.1f;
  const OrientedPoints all = with_normals(points, 15, 1);
  const Eigen::Vector3d expected = plain_normal(points, 0, 9);
  for (const auto& normal : all.normals)
    CHECK(std::abs(expected.dot(normal.cast<double>())) > 1 - 1e-5);
}

TEST_CASE("a ring above the sensor has no normals, two rings and a ring on the road have") {
  std::mt19937 random(3);
  std::normal_distribution<float> noise(0, 0.3f);
  const auto rings = [&](std::initializer_list<float> slopes, bool is_rough) {
    Matrix points(Eigen::Index(60 * slopes.size()), 3);
    Eigen::Index row = 0;
    for (const float slope : slopes)
      for (int k = 0; k < 60; ++k, ++row) {
        const float azimuth = 0.02f * float(k), away = 8 + (is_rough ? noise(random) : 0);
        points.row(row) << away * std::cos(azimuth), away * std::sin(azimuth), away * slope;
      }
    return points;
  };
  for (const auto& normal : with_normals(rings({0.2f}, true), 15, 1).normals)
    CHECK(normal.isZero());
  for (const auto& normal : with_normals(rings({0.2f, 0.21f}, true), 15, 1).normals)
    CHECK(normal.norm() == doctest::Approx(1));
  for (const auto& normal : with_normals(rings({-0.2f}, false), 15, 1).normals)
    CHECK(std::abs(normal.z()) > 0.999);
}

TEST_CASE("too few points have no normals") {
  const OrientedPoints few = with_normals(cloud(4, 1), 15, 1);
  REQUIRE(few.normals.size() == 4);
  for (const auto& normal : few.normals) CHECK(normal.isZero());
  CHECK(with_normals(cloud(0, 1), 15, 1).points.empty());
}
