#include "docdepth/render/straight_outlines.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <limits>

#include "docdepth/geometry/parallel.hpp"

namespace docdepth {
namespace {

/// A surface this much farther, and this share of the depth farther, is another one.
constexpr float kJump = 0.5f, kJumpShare = 1.15f;  // [m], [-]
/// Depths of one surface differ by a smaller share within a window.
constexpr float kSameSurface = 1.08f;
/// A window reaches over so many mean distances between returns up and down: two rings, which are
/// farther apart than the returns of a ring.
constexpr float kWindow = 2.3f;
/// Share of a window through which the outline goes on, with the nearer surface on the same side.
constexpr float kShown = 0.7f;
constexpr std::size_t kRowBlock = 16;  // of a thread at a time

bool jumps(float near, float far) {
  return far - near > kJump && far > kJumpShare * near;
}

/// Two surfaces on both sides of a jump.
struct Sides {
  float near = std::numeric_limits<float>::infinity(), far = 0;

  bool shows_near(float depth) const { return depth * depth < near * far; }
  bool shows_far(float depth) const { return depth * depth >= near * far; }
};

class Outlines {
 public:
  Outlines(const Camera& camera, float spacing, const std::vector<float>& depth)
      : width_(camera.width),
        height_(camera.height),
        reach_(int(std::lround(spacing / 2))),
        beside_(int(std::lround(spacing))),
        half_(int(std::lround(kWindow * spacing))),
        depth_(depth) {}

  int reach() const { return reach_; }

  /// Calls change(to, from) for each pixel of a row that shows what another one shows.
  template <class Change>
  void straighten(int v, const Change& change) const {
    const float* row = depth_.data() + std::size_t(v) * width_;
    int last = -1, done = 0;  // the pixel with depth before u, and the first one not looked at
    for (int u = 0; u < width_; ++u) {
      if (!(row[u] > 0)) continue;
      if (last >= 0 && u - last <= reach_ &&
          (jumps(row[last], row[u]) || jumps(row[u], row[last]))) {
        const int end = std::min(last + reach_ + 1, width_);
        for (int w = std::max({u - reach_, 0, done}); w < end; ++w)
          if (row[w] > 0) straighten(row, w, v, change);
        done = std::max(done, end);
      }
      last = u;
    }
  }

 private:
  template <class Change>
  void straighten(const float* row, int u, int v, const Change& change) const {
    Sides sides;
    for (int w = std::max(u - reach_, 0); w <= std::min(u + reach_, width_ - 1); ++w)
      if (row[w] > 0) {
        sides.near = std::min(sides.near, row[w]);
        sides.far = std::max(sides.far, row[w]);
      }
    if (!jumps(sides.near, sides.far)) return;
    const auto is_near = [&](float there) {
      return there < kSameSurface * sides.near && there * kSameSurface > sides.near;
    };
    if (u < beside_ || u + beside_ >= width_) return;
    const int inward = is_near(row[u - beside_]) ? -beside_ : beside_;
    int near = 0, far = 0, all = 0;
    for (int dv = -half_; dv <= half_; ++dv) {
      const int weight = half_ + 1 - std::abs(dv);
      all += weight;
      if (v + dv < 0 || v + dv >= height_) continue;
      const float* there = row + std::ptrdiff_t(dv) * width_ + u;
      if (!is_near(there[inward]) || !sides.shows_far(there[-inward])) continue;
      near += is_near(*there) ? weight : 0;
      far += sides.shows_far(*there) ? weight : 0;
    }
    const bool own = sides.shows_near(row[u]);
    if (float(near + far) < kShown * float(all) || (own ? far <= near : near <= far)) return;
    for (int away = 1; away <= reach_; ++away)
      for (const int w : {u - away, u + away})
        if (w >= 0 && w < width_ && row[w] > 0 && sides.shows_near(row[w]) != own) {
          change(std::size_t(v) * width_ + u, std::size_t(v) * width_ + w);
          return;
        }
  }

  int width_, height_;
  int reach_;   // of pixels that may change, to either side
  int beside_;  // where the two surfaces are told apart
  int half_;    // of a window, up and down
  const std::vector<float>& depth_;
};

}  // namespace

void straighten_outlines(const Camera& camera, float spacing, std::vector<float>& depth,
                         std::vector<std::uint16_t>& shown_objects, int threads) {
  const Outlines outlines(camera, spacing, depth);
  if (outlines.reach() < 1) return;
  struct Change {
    std::size_t to, from;
  };
  std::vector<std::vector<Change>> changes((camera.height + kRowBlock - 1) / kRowBlock);
  parallel_for(camera.height, kRowBlock, threads, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v)
      outlines.straighten(int(v), [&](std::size_t to, std::size_t from) {
        changes[begin / kRowBlock].push_back({to, from});
      });
  });
  const std::vector<float> before = depth;
  const std::vector<std::uint16_t> shown = shown_objects;
  for (const auto& some : changes)
    for (const auto& [to, from] : some) {
      depth[to] = before[from];
      if (!shown.empty()) shown_objects[to] = shown[from];
    }
}

}  // namespace docdepth
