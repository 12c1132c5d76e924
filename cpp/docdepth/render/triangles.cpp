#include "docdepth/render/triangles.hpp"

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/render/beyond_view.hpp"
#include "docdepth/render/depth_hypotheses.hpp"
#include "docdepth/render/raster.hpp"

namespace docdepth {
namespace {

struct DrawStrip {
  DOCDEPTH_KERNEL static void run(const Camera& camera, const MeshScene& scene, Strip& strip,
                                  std::vector<std::uint16_t>& owners) {
    for (const PlacedMesh& mesh : scene.trusted) draw_mesh(camera, mesh, strip);
    const Columns columns{strip.begin, strip.end - strip.begin, strip.height, Strip::kStride};
    DepthHypotheses hypotheses(columns, strip.inverse_depth);
    strip.open_only(hypotheses);
    for (const PlacedMesh& mesh : scene.others) {
      draw_mesh(camera, mesh, strip);
      hypotheses.add(strip.inverse_depth.data());
    }
    std::vector<float> inverse_depth = hypotheses.resolve(camera, scene.rays);
    std::fill(strip.open_tiles.begin(), strip.open_tiles.end(), std::uint8_t{1});
    std::vector<float> trusted(inverse_depth.size(), 0.0f);
    std::fill(strip.inverse_depth.begin(), strip.inverse_depth.end(), 0.0f);
    owners.assign(scene.dynamic_objects.empty() ? 0 : inverse_depth.size(), 0);
    std::uint16_t number = 0;
    for (const PlacedDynamicObject& object : scene.dynamic_objects) {
      ++number;
      bool seen = false;  // as long as it is false both images are empty
      for (const PlacedMesh& mesh : object.trusted) seen |= draw_mesh(camera, mesh, strip);
      std::swap(trusted, strip.inverse_depth);
      for (const PlacedMesh& mesh : object.others) seen |= draw_mesh(camera, mesh, strip);
      if (!seen) continue;
      add_dynamic_object(columns, camera, trusted, strip.inverse_depth, object.rays, number,
                         inverse_depth, owners);
      std::fill(trusted.begin(), trusted.end(), 0.0f);
      std::fill(strip.inverse_depth.begin(), strip.inverse_depth.end(), 0.0f);
    }
    strip.inverse_depth = std::move(inverse_depth);
  }
};

}  // namespace

std::vector<float> render_triangles(const Camera& camera, const MeshScene& scene, int threads) {
  std::vector<float> depth(std::size_t(camera.width) * camera.height);
  std::vector<std::uint16_t> owners(scene.dynamic_objects.empty() ? 0 : depth.size());
  parallel_for(camera.width, kStrip, threads, [&](std::size_t begin, std::size_t end) {
    Strip strip(static_cast<int>(begin), static_cast<int>(end), camera.height);
    std::vector<std::uint16_t> drawn;
    dispatch<DrawStrip>(camera, scene, strip, drawn);
    for (int v = 0; v < camera.height; ++v)
      for (int u = strip.begin; u < strip.end; ++u) {
        const std::size_t from = std::size_t(v) * Strip::kStride + (u - strip.begin);
        const std::size_t to = std::size_t(v) * camera.width + u;
        const float w = strip.inverse_depth[from];
        depth[to] = w > 0 ? 1.0f / w : std::numeric_limits<float>::quiet_NaN();
        if (!owners.empty()) owners[to] = drawn[from];
      }
  });
  empty_beyond_view(camera, scene, owners, depth);
  return depth;
}

}  // namespace docdepth
