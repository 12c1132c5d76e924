#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "docdepth/voting/mesh_image.hpp"
#include "docdepth/voting/range_image.hpp"

using namespace docdepth;

namespace {

using Cloud = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

/// A wall at x = `distance`, seen straight ahead through every pixel.
Cloud wall(float distance) {
  Cloud cloud(60 * 60, 3);
  for (int i = 0; i < 60; ++i)
    for (int j = 0; j < 60; ++j)
      cloud.row(60 * i + j) << distance, 0.02f * (i - 30), 0.02f * (j - 30);
  return cloud;
}

/// The votes of a key frame on one point straight ahead.
std::array<int, 2> votes_of_mesh(const Cloud& sweep, float distance) {
  const auto flags = std::make_unique<bool[]>(sweep.rows());
  const MeshImage image(sweep, flags.get(), build_scan_mesh(sweep, {}), {});
  Cloud point(1, 3);
  point << distance, 0.001f, 0.001f;
  const bool ground = false;
  const Votes votes =
      vote(point, &ground, Pose::Identity(), {&image}, {Pose::Identity()}, {0.0}, 1);
  return {votes.statics[0], votes.dynamics[0]};
}

/// The votes of a wall at 10 m on one point straight ahead.
std::array<int, 2> votes_of_wall(float distance, bool wall_is_ground) {
  const Cloud cloud = wall(10.0f);
  const auto flags = std::make_unique<bool[]>(cloud.rows());
  std::fill_n(flags.get(), cloud.rows(), wall_is_ground);
  const RangeImage image(cloud, flags.get(), {});
  Cloud point(1, 3);
  point << distance, 0.02f, 0.02f;
  const bool ground = false;
  const Votes votes =
      vote(point, &ground, Pose::Identity(), {&image}, {Pose::Identity()}, {0.0}, 1);
  return {votes.statics[0], votes.dynamics[0]};
}

/// Algorithm 1 of the paper, one point and one pixel after the other.
struct PlainImage {
  static constexpr int kHalf = 2;
  SphericalGrid grid;
  float tolerance;
  std::map<std::array<int, 2>, std::pair<float, bool>> nearest;  // by row and column: range, ground

  PlainImage(const Cloud& sweep, const bool* ground, double resolution, float tolerated)
      : grid(resolution), tolerance(tolerated) {
    for (Eigen::Index i = 0; i < sweep.rows(); ++i) {
      const float range = range_of(sweep(i, 0), sweep(i, 1), sweep(i, 2));
      const std::array<int, 2> pixel{grid.row(sweep(i, 2), range),
                                     grid.column(sweep(i, 0), sweep(i, 1))};
      const auto [found, is_new] = nearest.try_emplace(pixel, range, ground[i]);
      if (!is_new && range < found->second.first) found->second = {range, ground[i]};
    }
  }
  /// 1: static, -1: dynamic.
  int vote(const Eigen::RowVector3f& p) const {
    const float range = range_of(p.x(), p.y(), p.z());
    const int row = grid.row(p.z(), range), column = grid.column(p.x(), p.y());
    const auto centre = nearest.find({row, column});
    const bool on_ground = centre != nearest.end() && centre->second.second;
    const float tolerated = on_ground ? 0 : tolerance;
    int vote = 0;
    for (int v = row - kHalf; v <= row + kHalf; ++v)
      for (int u = column - kHalf; u <= column + kHalf; ++u) {
        const auto found = nearest.find({v, (u + grid.columns()) % grid.columns()});
        if (found == nearest.end()) continue;
        const float difference = range - found->second.first;
        if (std::fabs(difference) < tolerated) return 1;
        if (difference < -tolerated)
          vote = -1;
        else if (!on_ground)
          return 0;
      }
    return vote;
  }
};

}  // namespace

TEST_CASE("a wall votes static on it, dynamic before it and not at all behind it") {
  CHECK(votes_of_wall(10.0f, false) == std::array<int, 2>{1, 0});
  CHECK(votes_of_wall(10.1f, false) == std::array<int, 2>{1, 0});
  CHECK(votes_of_wall(9.5f, false) == std::array<int, 2>{0, 1});
  CHECK(votes_of_wall(12.0f, false) == std::array<int, 2>{0, 0});
}

TEST_CASE("before ground the tolerance is zero, and ground never votes static") {
  CHECK(votes_of_wall(9.99f, true) == std::array<int, 2>{0, 1});
  CHECK(votes_of_wall(10.1f, true) == std::array<int, 2>{0, 0});
}

TEST_CASE("votes are those of the plain loop, also at ties and very near or far") {
  std::mt19937 random(5);
  std::uniform_real_distribution<float> unit(0.0f, 1.0f);
  const std::unique_ptr<bool[]> ground(new bool[3000]());
  for (int i = 0; i < 3000; i += 7) ground[i] = true;
  for (const float reach : {0.5f, 2.0f, 20.0f, 300.0f}) {
    for (const float tolerance : {0.2f, 0.25f, 0.3f, 2.0f}) {
      for (const float grid : {0.0f, 1.0f / 64.0f}) {
        const float middle = reach * unit(random);
        const auto scatter = [&](int count) {
          Cloud cloud(count, 3);
          for (int i = 0; i < count; ++i) {
            const float steps = std::floor(6.0f * unit(random)) - 2.0f;
            float range = i % 4 ? middle + steps * tolerance : reach * unit(random);
            if (grid > 0.0f) range = grid * std::round(range / grid);
            range = std::max(range, 0.02f);
            // Every other one straight ahead, where ranges are exact.
            const float azimuth = i % 2 ? 0.0f : 0.2f * unit(random), z = 0.1f * range * (i % 3);
            cloud.row(i) << range * std::cos(azimuth), range * std::sin(azimuth), i % 2 ? 0.0f : z;
          }
          return cloud;
        };
        const Cloud sweep = scatter(500), points = scatter(3000);
        const RangeImage image(sweep, ground.get(), {0.0035, 5, tolerance});
        const PlainImage plain(sweep, ground.get(), 0.0035, tolerance);
        const Votes votes =
            vote(points, ground.get(), Pose::Identity(), {&image}, {Pose::Identity()}, {0.0}, 1);
        int wrong = 0;
        for (Eigen::Index i = 0; i < points.rows(); ++i) {
          const int expected = ground[std::size_t(i)] ? 0 : plain.vote(points.row(i));
          wrong += votes.statics[std::size_t(i)] != (expected > 0);
          wrong += votes.dynamics[std::size_t(i)] != (expected < 0);
        }
        CHECK(wrong == 0);
      }
    }
  }
}

/// A wall at 10 m, 4 x 4 returns; straight ahead lies between them.
Cloud sparse_wall(float spacing) {
  Cloud cloud(4 * 4, 3);
  for (int i = 0; i < 4; ++i)
    for (int j = 0; j < 4; ++j)
      cloud.row(4 * i + j) << 10.0f, spacing * (i - 1.5f), spacing * (j - 1.5f);
  return cloud;
}

TEST_CASE("the mesh of a wall votes between its returns, but not far from every ray") {
  const Cloud sparse = sparse_wall(0.16f);
  for (const float distance : {9.0f, 10.1f, 12.0f})
    CHECK(votes_of_mesh(sparse_wall(0.4f), distance) == std::array<int, 2>{0, 0});
  CHECK(votes_of_mesh(sparse, 10.1f) == std::array<int, 2>{1, 0});
  CHECK(votes_of_mesh(sparse, 9.0f) == std::array<int, 2>{0, 1});
  CHECK(votes_of_mesh(sparse, 12.0f) == std::array<int, 2>{0, 0});
}

TEST_CASE("across a discontinuity only points nearer than both sides are dynamic") {
  Cloud jump(2 * 40, 3);
  for (int i = 0; i < 40; ++i) {
    const float z = 0.1f * (i - 20), x = 10.0f;
    jump.row(2 * i) << x, 0.1f, z;
    jump.row(2 * i + 1) << 2 * x, -0.2f, 2 * z;
  }
  CHECK(votes_of_mesh(jump, 9.0f) == std::array<int, 2>{0, 1});
  CHECK(votes_of_mesh(jump, 10.1f) == std::array<int, 2>{1, 0});
  CHECK(votes_of_mesh(jump, 15.0f) == std::array<int, 2>{0, 0});
  CHECK(votes_of_mesh(jump, 30.0f) == std::array<int, 2>{0, 0});
}
