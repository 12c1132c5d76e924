#include <doctest/doctest.h>

#include <cmath>
#include <memory>
#include <random>
#include <vector>

#include "docdepth/geometry/normal.hpp"
#include "docdepth/ground/ground.hpp"
#include "docdepth/ground/voxel_map.hpp"

using namespace docdepth;
using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

namespace {

/// A plane that leans by `slope`, with a post standing on it.
Matrix scene(double slope) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> side(-4.f, 4.f), up(0.f, 2.f);
  Matrix points(20000, 3);
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    points.row(i) << side(random), side(random), 0.f;
    points(i, 2) = static_cast<float>(std::tan(slope) * points(i, 0)) - 1.7f;
  }
  for (Eigen::Index i = 0; i < 500; ++i) points.row(i) << 1.f, 1.f, up(random);
  return points;
}

std::vector<bool> grow(const Matrix& points, const GroundParameters& parameters, int threads) {
  GroundMap map(parameters, threads);
  map.insert(points, Pose::Identity());
  map.grow();
  std::vector<char> ground(points.rows());
  map.label(points, Pose::Identity(), reinterpret_cast<bool*>(ground.data()));
  return {ground.begin(), ground.end()};
}

}  // namespace

TEST_CASE("a gentle slope is ground, a steep one is not, the post never") {
  GroundParameters lowest;
  lowest.seed_quantile = 0;
  lowest.least_share = 0;
  for (const double degrees : {0.0, 10.0, 20.0}) {
    for (const GroundParameters& parameters : {lowest, GroundParameters()}) {
      const auto ground = grow(scene(degrees * M_PI / 180.0), parameters, 1);
      std::size_t plane = 0, post = 0;
      for (std::size_t i = 0; i < ground.size(); ++i) (i < 500 ? post : plane) += ground[i];
      CHECK(post == 0);
      if (degrees < 15.0)
        CHECK(plane == ground.size() - 500);
      else  // the seed, or those of its voxel
        CHECK(plane <= (parameters.seed_quantile > 0 ? 2 : 1));
    }
  }
}

TEST_CASE("threads change nothing") {
  const Matrix points = scene(0.1);
  CHECK(grow(points, {}, 1) == grow(points, {}, 2));
}

TEST_CASE("an empty map has no ground") {
  GroundMap map({}, 1);
  CHECK(map.grow() == 0);
  map.insert(Matrix(0, 3), Pose::Identity());
  CHECK(map.grow() == 0);
}

TEST_CASE("the voxels of points, and points too far for any") {
  Pose pose(Eigen::AngleAxisd(0.4, Eigen::Vector3d(1, 2, 3).normalized()));
  for (const bool turned : {false, true}) {
    const Eigen::Vector3d origin(0.3 * turned, 0, 0);
    const Pose T = turned ? pose : Pose::Identity();
    const double size = 0.03125;
    const VoxelGrid grid(T, origin, size);
    Matrix points(Addressed::kMost, 3);
    std::mt19937 random(1);
    std::uniform_real_distribution<float> place(-80.f, 80.f);
    for (Eigen::Index i = 0; i < points.size(); ++i) {
      points.data()[i] = place(random);
      // Every other one on a border between voxels.
      if (i % 2) points.data()[i] = std::round(points.data()[i] * 32.f) / 32.f;
    }
    if (!turned) points.row(0) << -32768.f, 0.f, 32767.998f;
    const auto found = std::make_unique<Addressed>();
    grid.find(points.data(), points.rows(), *found);
    std::size_t wrong = 0;
    for (Eigen::Index i = 0; i < points.rows(); ++i) {
      const Eigen::Vector3d p = found->point(i);
      wrong += (T * points.row(i).transpose().cast<double>() - origin - p).norm() > 1e-9;
      std::uint64_t key = 0, bit = 0;
      for (int axis = 0; axis < 3; ++axis) {
        const auto index = static_cast<std::uint64_t>(std::floor(p[axis] / size) + (1 << 20));
        key = key << 19 | index >> 2;
        bit = bit << 2 | (index & 3);
      }
      wrong += found->key[i] != key || found->bit[i] != bit;
      wrong += found->shard[i] >= VoxelMap::kShards;
    }
    CHECK(wrong == 0);
    for (const float wild : {NAN, INFINITY, -32768.01f, 32768.f}) {
      if (turned && std::isfinite(wild)) continue;
      points(7, 1) = wild;
      CHECK_THROWS_AS(grid.find(points.data(), points.rows(), *found), std::out_of_range);
    }
  }
}
