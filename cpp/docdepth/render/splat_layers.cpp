#include <atomic>
#include <bit>
#include <cmath>
#include <limits>
#include <memory>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/rigid.hpp"
#include "docdepth/render/layers.hpp"

namespace docdepth {
namespace {

/// The measurements of a pixel. Sums of integers, so that their order does not matter.
struct SplatTally {
  std::atomic<std::uint64_t> best{~0ull};  // relative difference (32 bits), number of the point
  std::atomic<std::uint32_t> support{0}, measures{0};
  std::atomic<std::int64_t> sum{0}, squares{0};  // of differences in kSteps
};

constexpr float kSteps = 1 << 20;  // to 1: relative differences are summed as integers

/// Compare the splat of one point with the depth map.
void compare(const Camera& camera, const Eigen::Vector3f& p, int size, std::uint32_t number,
             const float* depth, SplatTally* tallies) {
  // The same operations as in splats.cpp, so that the pixel is the same.
  const float column = (float(camera.fx) * p.x()) / p.z() + float(camera.cx) + 0.5f;
  const float row = (float(camera.fy) * p.y()) / p.z() + float(camera.cy) + 0.5f;
  if (!(p.z() > kNear && column >= 0 && column < float(camera.width) && row >= 0 &&
        row < float(camera.height)))
    return;
  const int u = int(column), v = int(row);
  for (int dv = -size / 2; dv <= size / 2; ++dv) {
    if (v + dv < 0 || v + dv >= camera.height) continue;
    const int half = int(std::sqrt(float(size * size - 4 * dv * dv)) / 3.0f + 1e-4f);
    for (int at = std::max(u - half, 0); at <= std::min(u + half, camera.width - 1); ++at) {
      const std::size_t i = std::size_t(v + dv) * camera.width + at;
      if (!(depth[i] > 0)) continue;
      SplatTally& tally = tallies[i];
      tally.measures.fetch_add(1, std::memory_order_relaxed);
      const float off = (p.z() - depth[i]) / depth[i], difference = std::fabs(off);
      if (difference > kAgree) continue;
      const auto steps = std::int64_t(std::lround(off * kSteps));
      tally.support.fetch_add(1, std::memory_order_relaxed);
      tally.sum.fetch_add(steps, std::memory_order_relaxed);
      tally.squares.fetch_add(steps * steps, std::memory_order_relaxed);
      const auto bits = std::bit_cast<std::uint32_t>(difference);  // ordered like positive floats
      const std::uint64_t mine = (std::uint64_t(bits) << 32) | number;
      std::uint64_t best = tally.best.load(std::memory_order_relaxed);
      while (mine < best && !tally.best.compare_exchange_weak(best, mine)) {
      }
    }
  }
}

float deviation_of_splats(const SplatTally& tally, float depth) {
  const double n = tally.support;
  if (n < 2) return std::numeric_limits<float>::quiet_NaN();
  const double sum = double(tally.sum), squares = double(tally.squares);
  return depth * float(std::sqrt(std::max((squares - sum * sum / n) / (n - 1), 0.0)) / kSteps);
}

}  // namespace

Layers layers_of_splats(const Camera& camera, const std::vector<PlacedCloud>& clouds,
                        const float* depth, int threads) {
  const std::size_t pixels = std::size_t(camera.width) * camera.height;
  const auto tallies = std::make_unique<SplatTally[]>(pixels);
  std::vector<std::uint32_t> first{0};  // number of the first point of each cloud
  for (const auto& placed : clouds)
    first.push_back(first.back() + std::uint32_t(placed.cloud->size()));
  parallel_for(clouds.size(), 1, threads, [&](std::size_t c, std::size_t) {
    const Frustum frustum(camera, clouds[c].T_camera_cloud);
    const Cloud& cloud = *clouds[c].cloud;
    if (!cloud.size() || !frustum.touches(cloud.box())) return;
    const RigidTransform T(clouds[c].T_camera_cloud);
    for (const auto& block : cloud.blocks()) {
      if (!frustum.touches(block.box)) continue;
      for (std::uint32_t i = block.begin; i < block.end; ++i) {
        const Eigen::Vector3f p = T * Eigen::Vector3f(cloud.x()[i], cloud.y()[i], cloud.z()[i]);
        const float squared = (p.x() * p.x() + p.y() * p.y()) + p.z() * p.z();
        compare(camera, p, (*clouds[c].heights)(squared), first[c] + i, depth, tallies.get());
      }
    }
  });

  Layers layers(camera, false);
  for (std::size_t i = 0; i < pixels; ++i) {
    const SplatTally& tally = tallies[i];
    if (!tally.support) continue;
    const auto number = std::uint32_t(tally.best.load());
    const std::size_t c =
        std::size_t(std::upper_bound(first.begin(), first.end(), number) - first.begin()) - 1;
    const Cloud& cloud = *clouds[c].cloud;
    const std::uint32_t k = number - first[c];
    layers.sweep[i] = clouds[c].sweep;
    layers.classid[i] = cloud.classes()[k];
    layers.measured[i] = 1;
    layers.range[i] = Eigen::Vector3f(cloud.x()[k], cloud.y()[k], cloud.z()[k]).norm();
    layers.support[i] = std::uint16_t(std::min<std::uint32_t>(tally.support, 65535));
    layers.measures[i] = std::uint16_t(std::min<std::uint32_t>(tally.measures, 65535));
    layers.deviation[i] = deviation_of_splats(tally, depth[i]);
  }
  return layers;
}

}  // namespace docdepth
