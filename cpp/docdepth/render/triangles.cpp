#include "docdepth/render/triangles.hpp"

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/render/raster.hpp"

namespace docdepth {
namespace {

DOCDEPTH_INLINE void load(const float* from, Floats& values) {
  std::memcpy(&values, from, sizeof values);
}

DOCDEPTH_INLINE void store(const Floats& values, float* to) {
  std::memcpy(to, &values, sizeof values);
}

/// What the strip is made of while sweeps are weighed against each other, and nothing of it yet.
struct Scales {
  std::vector<float> locked;  ///< the strip before a sweep is drawn
  std::vector<float> chosen, waiting;

  explicit Scales(const Strip& strip)
      : locked(strip.nearness), chosen(locked.size(), 0.0f), waiting(locked.size(), 0.0f) {}
};

/// Takes one more measurement of each open pixel, and clears it. The first is chosen; one that is
/// nearer waits until another confirms it.
DOCDEPTH_INLINE void weigh(Strip& strip, Scales& scales) {
  constexpr float more = 1 / (1 - kAgree), less = 1 / (1 + kAgree);
  for (int v = 0; v < strip.height; ++v)
    for (int tile = 0; tile < Strip::kTiles; ++tile) {
      if (!strip.open_tiles[(v / Strip::kTile) * Strip::kTiles + tile]) continue;
      const std::size_t i = std::size_t(v) * Strip::kStride + tile * Strip::kTile;
      Floats w, locked, chosen, waiting;
      load(&strip.nearness[i], w), load(&scales.locked[i], locked);
      load(&scales.chosen[i], chosen), load(&scales.waiting[i], waiting);
      const Integers known = (w > 0.0f) & (w < kLocked), first = known & (chosen == 0.0f);
      const Integers nearer = known & ~first & (w > chosen * more);
      const Integers confirmed = nearer & (w < waiting * more) & (w > waiting * less);
      const Floats better = confirmed ? waiting : chosen, later = nearer ? w : waiting;
      store(first ? w : better, &scales.chosen[i]);
      store(confirmed ? Floats{} : later, &scales.waiting[i]);
      store(locked, &strip.nearness[i]);
    }
}

DOCDEPTH_INLINE void draw_strip(const Camera& camera, const Drawing& drawing, Strip& strip) {
  for (const PlacedMesh& mesh : drawing.trusted) draw_mesh(camera, mesh, strip);
  std::vector<float> result = strip.nearness;
  strip.lock();
  Scales scales(strip);
  for (const PlacedMesh& mesh : drawing.others) {
    draw_mesh(camera, mesh, strip);
    weigh(strip, scales);
  }
  for (std::size_t i = 0; i < result.size(); ++i) result[i] = std::max(result[i], scales.chosen[i]);
  strip.nearness = std::move(result);
  std::fill(strip.open_tiles.begin(), strip.open_tiles.end(), std::uint8_t{1});
  for (const PlacedMesh& mesh : drawing.movers) draw_mesh(camera, mesh, strip);
}

DOCDEPTH_AVX2 void draw_strip_avx2(const Camera& camera, const Drawing& drawing, Strip& strip) {
  draw_strip(camera, drawing, strip);
}
void draw_strip_plain(const Camera& camera, const Drawing& drawing, Strip& strip) {
  draw_strip(camera, drawing, strip);
}

}  // namespace

std::vector<float> render_triangles(const Camera& camera, const Drawing& drawing, int threads) {
  const auto draw = DOCDEPTH_HAS_AVX2() ? draw_strip_avx2 : draw_strip_plain;
  std::vector<float> depth(std::size_t(camera.width) * camera.height);
  parallel_for(camera.width, kStrip, threads, [&](std::size_t begin, std::size_t end) {
    Strip strip(static_cast<int>(begin), static_cast<int>(end), camera.height);
    draw(camera, drawing, strip);
    for (int v = 0; v < camera.height; ++v)
      for (int u = strip.begin; u < strip.end; ++u) {
        const float w = strip.nearness[std::size_t(v) * Strip::kStride + (u - strip.begin)];
        depth[std::size_t(v) * camera.width + u] =
            w > 0 ? 1.0f / w : std::numeric_limits<float>::quiet_NaN();
      }
  });
  return depth;
}

}  // namespace docdepth
