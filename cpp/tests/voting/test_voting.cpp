#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <numeric>
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

/// A street with houses, a fence of slats, and a car that drives along it, as a LiDAR of 64 rings
/// sees it.
class Street {
 public:
  /// The sweep number `k`, two metres after the one before.
  explicit Street(int k) : pose(Pose::Identity()) {
    pose(0, 3) = 2.0 * k;
    const float car = 34.0f + 3.0f * static_cast<float>(14 - k);  // in the world
    for (int ring = 0; ring < 64; ++ring)
      for (int column = 0; column < 900; ++column) {
        const float elevation = 0.05f - 0.007f * static_cast<float>(ring);
        const float azimuth = 6.2831853f * static_cast<float>(column) / 900;
        const Eigen::Vector3f ray(std::cos(elevation) * std::cos(azimuth),
                                  std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
        float range = ray.z() < 0 ? -1.8f / ray.z() : 1e9f;
        bool on_ground = true;
        const float x = static_cast<float>(pose(0, 3));
        // Houses along both sides with gaps, the fence before some of them, and the car.
        for (int house = -8; house < 20; ++house)
          for (const float y : {-9.0f, 8.0f})
            hit(ray, {12.0f * house - x, y, -2}, {12.0f * house + 9 - x, y + 1, 6}, range,
                on_ground);
        const Eigen::Vector3f behind = ray * (5.5f / ray.y());
        if (ray.y() > 0 && behind.norm() < range && behind.z() < 0 && std::abs(behind.x()) < 20 &&
            std::fmod(behind.x() + x + 100, 0.3f) < 0.1f) {
          range = behind.norm();
          on_ground = false;
        }
        hit(ray, {car - x, 2.0f, -1.7f}, {car + 4 - x, 3.8f, -0.3f}, range, on_ground);
        if (range > 70) continue;
        returns.push_back(range * ray);
        flags.push_back(on_ground);
      }
  }

  /// The sweep as voting takes it, its rows shuffled if there is a seed.
  std::pair<Cloud, std::unique_ptr<bool[]>> sweep(unsigned seed = 0) const {
    std::vector<std::size_t> order(returns.size());
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
    if (seed) std::shuffle(order.begin(), order.end(), std::mt19937(seed));
    Cloud cloud(Eigen::Index(order.size()), 3);
    std::unique_ptr<bool[]> ground(new bool[order.size()]);
    for (std::size_t i = 0; i < order.size(); ++i) {
      cloud.row(Eigen::Index(i)) = returns[order[i]];
      ground[i] = flags[order[i]];
    }
    return {cloud, std::move(ground)};
  }

  Pose pose;
  std::vector<Eigen::Vector3f> returns;
  std::vector<bool> flags;

 private:
  /// The range where a ray enters a box, if that is nearer.
  static void hit(const Eigen::Vector3f& ray, const Eigen::Vector3f& low,
                  const Eigen::Vector3f& high, float& range, bool& on_ground) {
    const Eigen::Array3f a = low.array() / ray.array(), b = high.array() / ray.array();
    const float in = a.min(b).maxCoeff(), out = a.max(b).minCoeff();
    if (in > out || in < 0 || in >= range) return;
    range = in;
    on_ground = false;
  }
};

TEST_CASE("votes from coarse to fine lose less than a hundredth of what all votes decide") {
  std::vector<std::unique_ptr<MeshImage>> images;
  std::vector<const KeyFrame*> key_frames;
  std::vector<Pose> poses;
  std::vector<double> seconds;
  for (int k = 0; k < 29; ++k) {
    if (k == 14) continue;
    const Street street(k);
    const auto [cloud, ground] = street.sweep();
    images.push_back(std::make_unique<MeshImage>(cloud, ground.get(), build_scan_mesh(cloud, {}),
                                                 MeshImageParameters{}));
    key_frames.push_back(images.back().get());
    poses.push_back(street.pose);
    seconds.push_back(0.1 * (k - 14));
  }
  for (const unsigned seed : {0u, 7u}) {
    const Street street(14);
    const auto [cloud, ground] = street.sweep(seed);
    const auto votes_of = [&, &cloud = cloud, &ground = ground](int threads, bool coarse_first) {
      return vote(cloud, ground.get(), street.pose, key_frames, poses, seconds, threads,
                  coarse_first);
    };
    const Votes all = votes_of(1, false), some = votes_of(1, true), again = votes_of(3, true);
    CHECK(some.statics == again.statics);
    CHECK(some.dynamics == again.dynamics);
    CHECK(some.occupied_once == again.occupied_once);
    CHECK(some.porous == again.porous);
    CHECK(some.first_occupied == again.first_occupied);
    CHECK(some.last_occupied == again.last_occupied);
    int decided = 0, lost = 0, found = 0, porous = 0, solid = 0, same = 0, inexact = 0;
    for (std::size_t i = 0; i < all.statics.size(); ++i) {
      const bool moves = all.dynamics[i] > all.statics[i];
      const bool told = some.dynamics[i] > some.statics[i];
      decided += moves;
      lost += moves && !told;
      found += told && !moves;
      // Where rays mostly hit it, nobody asks whether a thing is porous.
      const bool asked = !ground[i] && all.porous[i] && 8 * all.dynamics[i] > all.statics[i];
      porous += asked;
      solid += asked && !some.porous[i];
      const bool equal = all.statics[i] == some.statics[i] && all.dynamics[i] == some.dynamics[i] &&
                         all.occupied_once[i] == some.occupied_once[i] &&
                         all.porous[i] == some.porous[i] &&
                         all.first_occupied[i] == some.first_occupied[i] &&
                         all.last_occupied[i] == some.last_occupied[i];
      same += equal;
      inexact += !equal && !ground[i] && (some.dynamics[i] || some.porous[i]);
    }
    INFO("decided ", decided, ", lost ", lost, ", porous ", porous, ", lost ", solid, ", same ",
         same, " of ", all.statics.size());
    CHECK(decided > 200);
    CHECK(100 * lost < decided);
    CHECK(found == 0);
    CHECK(porous > 200);
    CHECK(100 * solid < porous);
    CHECK(inexact == 0);
    CHECK(3 * std::size_t(same) < 2 * all.statics.size());
  }
}

TEST_CASE("few key frames, or such without a time, vote on all points") {
  const Street street(0), next(1);
  const auto [cloud, ground] = street.sweep();
  const auto [other, other_ground] = next.sweep();
  const MeshImage image(other, other_ground.get(), build_scan_mesh(other, {}), {});
  const auto votes_of = [&, &cloud = cloud, &ground = ground](std::vector<double> seconds,
                                                              bool coarse_first) {
    const std::vector<const KeyFrame*> key_frames(seconds.size(), &image);
    const std::vector<Pose> poses(seconds.size(), next.pose);
    return vote(cloud, ground.get(), street.pose, key_frames, poses, seconds, 1, coarse_first);
  };
  std::vector<double> often(24);
  std::iota(often.begin(), often.end(), 1);
  CHECK(votes_of(often, false).statics != votes_of(often, true).statics);
  often.pop_back();
  const std::vector<double> unknown(30, INFINITY);
  for (const auto& seconds : {often, unknown}) {
    const Votes all = votes_of(seconds, false), some = votes_of(seconds, true);
    CHECK(all.statics == some.statics);
    CHECK(all.dynamics == some.dynamics);
  }
}
