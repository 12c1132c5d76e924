#include <doctest/doctest.h>

#include <Eigen/LU>
#include <cmath>
#include <random>

#include "docdepth/odometry/gaussian_voxel_map.hpp"

using namespace docdepth;

namespace {

/// Three walls that meet in a corner, as a LiDAR between them sees them.
OrientedPoints corner(int count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> any(0, 12);
  OrientedPoints cloud;
  for (int i = 0; i < count; ++i) {
    Eigen::Vector3f p(any(random), any(random), any(random));
    const int axis = i % 3;
    p[axis] = 0.25f;  // the middle of a voxel
    cloud.points.push_back(p - Eigen::Vector3f(5, 4, 3));
    cloud.normals.push_back(Eigen::Vector3f::Unit(axis));
  }
  return cloud;
}

Pose pose_of(double angle, const Eigen::Vector3d& axis, const Eigen::Vector3d& position) {
  Pose pose = Pose::Identity();
  pose.linear() = Eigen::AngleAxisd(angle, axis.normalized()).toRotationMatrix();
  pose.translation() = position;
  return pose;
}

/// Half of the weighted squares of a cloud at a pose, by a plain look at each point of the map.
/// Cauchy's weights are those at another pose.
double plain_cost(const OrientedPoints& map, const OrientedPoints& cloud, const Pose& at,
                  const Pose& pose, double edge) {
  const auto cell = [&](const Eigen::Vector3d& p) {
    return Eigen::Vector3d((p / edge).array().floor());
  };
  double cost = 0;
  for (std::size_t i = 0; i < cloud.points.size(); ++i) {
    // Which voxel a point falls into is asked at the pose around which the cost is developed.
    const Eigen::Vector3d here = cell(at * cloud.points[i].cast<double>());
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    int count = 0;
    for (std::size_t j = 0; j < map.points.size(); ++j) {
      const Eigen::Vector3d p = map.points[j].cast<double>(), n = map.normals[j].cast<double>();
      if (cell(p) != here) continue;
      mean += p;
      covariance += Eigen::Matrix3d::Identity() - 0.999 * n * n.transpose();
      ++count;
    }
    if (!count) continue;
    const Eigen::Vector3d n = at.linear() * cloud.normals[i].cast<double>();
    covariance =
        (covariance / count + Eigen::Matrix3d::Identity() - 0.999 * n * n.transpose()).eval();
    const Eigen::Matrix3d weight = covariance.inverse();
    const Eigen::Vector3d p = cloud.points[i].cast<double>();
    const Eigen::Vector3d before = mean / count - at * p, off = mean / count - pose * p;
    const double tolerated = std::hypot(0.3, 1e-3 * p.norm());
    const double far = before.dot(weight * before) * 2e-3 / (tolerated * tolerated);
    cost += 0.5 * off.dot(weight * off) / (1 + far);
  }
  return cost;
}

}  // namespace

TEST_CASE("a cloud is moved back to where it was measured") {
  RegistrationOptions options;
  GaussianVoxelMap map(options);
  map.insert(corner(6000, 1), Pose::Identity());
  const Pose moved = pose_of(0.03, {1, -2, 3}, {0.2, -0.15, 0.1});
  OrientedPoints cloud = corner(3000, 2);
  for (std::size_t i = 0; i < cloud.points.size(); ++i) {
    cloud.points[i] = (moved.inverse() * cloud.points[i].cast<double>()).cast<float>();
    cloud.normals[i] = moved.linear().transpose().cast<float>() * cloud.normals[i];
  }
  const Alignment found = map.align(cloud, Pose::Identity(), 1);
  CHECK((found.T_map_cloud.translation() - moved.translation()).norm() < 2e-3);
  CHECK(Eigen::AngleAxisd(found.T_map_cloud.linear().transpose() * moved.linear()).angle() < 5e-4);
  CHECK(found.inliers > 2900);
  for (const int threads : {2, 3}) {
    const Alignment again = map.align(cloud, Pose::Identity(), threads);
    CHECK(again.T_map_cloud.matrix() == found.T_map_cloud.matrix());
    CHECK(again.hessian == found.hessian);
  }
}

TEST_CASE("a few points that moved do not move the cloud") {
  RegistrationOptions options;
  options.tolerance = 0.05;
  GaussianVoxelMap map(options);
  map.insert(corner(6000, 1), Pose::Identity());
  OrientedPoints cloud = corner(3000, 2);
  for (std::size_t i = 0; i < 300; ++i) cloud.points[i] += 0.2f * cloud.normals[i];
  // Least squares would move it by a tenth of 20 cm along each axis.
  const Alignment found = map.align(cloud, Pose::Identity(), 1);
  CHECK(found.T_map_cloud.translation().norm() < 3e-3);
  CHECK(found.inliers > 2900);
}

TEST_CASE("the Hessian is that of the weighted squares") {
  RegistrationOptions options;
  options.max_iterations = 1;
  options.max_distance = 10;
  GaussianVoxelMap map(options);
  const OrientedPoints walls = corner(900, 1), cloud = corner(120, 2);
  map.insert(walls, Pose::Identity());
  const Pose at = pose_of(0.02, {1, 1, 0}, {0.1, 0.05, 0.02});
  const Alignment found = map.align(cloud, at, 1);
  const auto cost = [&](const Eigen::Matrix<double, 6, 1>& step) {
    Pose pose = at;
    const Eigen::Vector3d turn = step.head<3>();
    if (turn.norm() > 0)
      pose.linear() =
          Eigen::AngleAxisd(turn.norm(), turn.normalized()) * Eigen::Matrix3d(at.linear());
    pose.translation() += step.tail<3>();
    return plain_cost(walls, cloud, at, pose, options.voxel_size);
  };
  // Beside the squares of first derivatives, a cost has second derivatives of rotations: they are
  // left out by Gauss-Newton, and none is there for positions.
  constexpr double h = 1e-4;
  for (int i = 3; i < 6; ++i)
    for (int j = 3; j < 6; ++j) {
      Eigen::Matrix<double, 6, 1> a = Eigen::Matrix<double, 6, 1>::Zero(), b = a;
      a(i) += h, a(j) += h, b(i) += h, b(j) -= h;
      const double second = (cost(a) - cost(b) - cost(-b) + cost(-a)) / (4 * h * h);
      CHECK(second == doctest::Approx(found.hessian(i, j)).epsilon(1e-4).scale(1000));
    }
  // The step of one iteration leads towards the least squares.
  const Eigen::Matrix<double, 6, 1> none = Eigen::Matrix<double, 6, 1>::Zero();
  CHECK(plain_cost(walls, cloud, at, found.T_map_cloud, options.voxel_size) < 0.2 * cost(none));
}

TEST_CASE("voxels that are not touched any more are forgotten, ten insertions apart") {
  RegistrationOptions options;
  GaussianVoxelMap map(options);
  OrientedPoints point{{Eigen::Vector3f(0.5f, 0.5f, 0.5f)}, {Eigen::Vector3f::UnitX()}};
  map.insert(point, Pose::Identity());
  for (int k = 1; k < 110; ++k) {
    CHECK(map.voxels().size() == (k == 1 ? 1 : 2));
    map.insert(point, pose_of(0, {1, 0, 0}, {20, 0, 0}));
  }
  CHECK(map.voxels().size() == 1);
}

TEST_CASE("a cloud far from the map stays at its guess") {
  GaussianVoxelMap map(RegistrationOptions{});
  const OrientedPoints cloud = corner(100, 1);
  const Pose guess = pose_of(0.1, {0, 0, 1}, {1, 2, 3});
  CHECK(map.align(cloud, guess, 1).inliers == 0);
  CHECK(map.align(cloud, guess, 1).T_map_cloud.matrix() == guess.matrix());
}
