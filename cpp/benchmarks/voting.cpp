// Votes per second on a synthetic street, compared with the plain loop of Algorithm 1: medians of
// the processor time of several runs that take turns.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <functional>
#include <memory>
#include <random>
#include <vector>

#include "docdepth/voting/mesh_image.hpp"
#include "docdepth/voting/range_image.hpp"
#include "keep_memory.hpp"

using namespace docdepth;

namespace {

using Cloud = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

struct Sweep {
  Cloud points;
  std::vector<char> ground;
  Pose pose = Pose::Identity();

  const bool* flags() const { return reinterpret_cast<const bool*>(ground.data()); }
};

/// A sensor of 64 beams x 1900 columns on a street between house fronts, with a post every 6 m.
Sweep scan(double along) {
  std::mt19937 random(static_cast<unsigned>(100 * along));
  std::normal_distribution<float> noise(0.0f, 0.02f);
  Sweep sweep;
  sweep.pose.translation().x() = along;
  sweep.points.resize(64 * 1900, 3);
  for (int i = 0; i < sweep.points.rows(); ++i) {
    const double elevation = (2.0 - 26.8 * (i / 1900) / 63.0) * M_PI / 180.0;
    const double azimuth = M_PI - 2.0 * M_PI * (i % 1900 + 0.3) / 1900.0;
    const Eigen::Vector3d u(std::cos(elevation) * std::cos(azimuth),
                            std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
    const double front = 9.0 / std::max(1e-3, std::abs(u.y()));
    const double road = u.z() < 0.0 ? -1.7 / u.z() : 1e9;
    const double post = 5.0 / std::max(1e-3, std::abs(u.y()));
    const double at_post = std::fmod(along + 600.0 + post * u.x(), 6.0);
    double range = std::min({front, road, 110.0});
    if (post < range && at_post < 0.5) range = post;
    sweep.points.row(i) = ((range + noise(random)) * u).cast<float>();
    sweep.ground.push_back(range == road);
  }
  return sweep;
}

double seconds(const std::function<void()>& work) {
  const std::clock_t start = std::clock();
  work();
  return static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
}

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

}  // namespace

/// Votes against meshes, ground included, as in the default preset.
void vote_on_meshes(const Sweep& query) {
  std::vector<std::unique_ptr<MeshImage>> owned;
  std::vector<const KeyFrame*> frames;
  std::vector<Pose> poses;
  std::vector<double> builds, times;
  for (int k = -15; k <= 15; ++k) {
    if (k == 0) continue;
    const Sweep sweep = scan(2.0 * k);
    builds.push_back(seconds([&] {
      owned.push_back(std::make_unique<MeshImage>(
          sweep.points, sweep.flags(), build_scan_mesh(sweep.points, {}), MeshImageParameters{}));
    }));
    frames.push_back(owned.back().get());
    poses.push_back(sweep.pose);
  }
  const std::vector<char> off(query.points.rows(), 0);
  const auto* ground = reinterpret_cast<const bool*>(off.data());
  for (int run = 0; run < 7; ++run)
    times.push_back(seconds([&] { vote(query.points, ground, query.pose, frames, poses, 1); }));
  const double votes = static_cast<double>(query.points.rows()) * poses.size();
  std::printf(
      "meshes: %.2f M votes of %zu key frames: %.1f M votes/s, %.1f ms; making one: %.1f ms\n",
      1e-6 * votes, poses.size(), 1e-6 * votes / median(times), 1e3 * median(times),
      1e3 * median(builds));
}

int main() {
  keep_memory();
  const Sweep query = scan(0.0);
  std::vector<std::unique_ptr<RangeImage>> owned;
  std::vector<const KeyFrame*> frames[2];
  std::vector<Pose> poses;
  RangeImageParameters parameters;
  for (int k = -15; k <= 15; ++k) {
    if (k == 0) continue;
    const Sweep sweep = scan(2.0 * k);
    for (const bool plain : {false, true}) {
      parameters.plain = plain;
      owned.push_back(std::make_unique<RangeImage>(sweep.points, sweep.flags(), parameters));
      frames[plain].push_back(owned.back().get());
    }
    poses.push_back(sweep.pose);
  }
  const auto off_ground = std::count(query.ground.begin(), query.ground.end(), 0);
  const double votes = static_cast<double>(off_ground) * poses.size();

  Votes result[2];
  std::vector<double> times[2], builds;
  parameters.plain = false;
  for (int run = 0; run < 7; ++run) {
    for (const bool plain : {false, true})
      times[plain].push_back(seconds([&] {
        result[plain] = vote(query.points, query.flags(), query.pose, frames[plain], poses, 1);
      }));
    builds.push_back(seconds([&] { RangeImage(query.points, query.flags(), parameters); }));
  }
  const bool equal =
      result[0].statics == result[1].statics && result[0].dynamics == result[1].dynamics;
  const double fast = votes / median(times[0]), plain = votes / median(times[1]);
  std::printf(
      "%.2f M votes of %zu key frames: %.1f M votes/s, plain loop %.1f M votes/s, %.1f times; %s\n",
      1e-6 * votes, poses.size(), 1e-6 * fast, 1e-6 * plain, fast / plain,
      equal ? "equal votes" : "VOTES DIFFER");
  std::printf("making a key frame: %.2f ms\n", 1e3 * median(builds));
  vote_on_meshes(query);
  return equal ? 0 : 1;
}
