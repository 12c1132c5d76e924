#include "docdepth/render/triangles.hpp"

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/render/candidates.hpp"
#include "docdepth/render/raster.hpp"

namespace docdepth {
namespace {

DOCDEPTH_INLINE void draw_strip(const Camera& camera, const Drawing& drawing, Strip& strip) {
  for (const PlacedMesh& mesh : drawing.trusted) draw_mesh(camera, mesh, strip);
  const Columns columns{strip.begin, strip.end - strip.begin, strip.height, Strip::kStride};
  Candidates candidates(columns, strip.nearness);
  strip.open_only(candidates);
  for (const PlacedMesh& mesh : drawing.others) {
    draw_mesh(camera, mesh, strip);
    candidates.take(strip.nearness.data());
  }
  std::vector<float> nearness = candidates.settle(camera, drawing.rays);
  std::fill(strip.open_tiles.begin(), strip.open_tiles.end(), std::uint8_t{1});
  std::vector<float> trusted(nearness.size(), 0.0f);
  std::fill(strip.nearness.begin(), strip.nearness.end(), 0.0f);
  for (const PlacedMover& mover : drawing.movers) {
    bool seen = false;  // while it is not, both images are empty
    for (const PlacedMesh& mesh : mover.trusted) seen |= draw_mesh(camera, mesh, strip);
    std::swap(trusted, strip.nearness);
    for (const PlacedMesh& mesh : mover.others) seen |= draw_mesh(camera, mesh, strip);
    if (!seen) continue;
    add_mover(columns, camera, trusted, strip.nearness, mover.rays, nearness);
    std::fill(trusted.begin(), trusted.end(), 0.0f);
    std::fill(strip.nearness.begin(), strip.nearness.end(), 0.0f);
  }
  strip.nearness = std::move(nearness);
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
