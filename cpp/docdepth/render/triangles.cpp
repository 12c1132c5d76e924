#include "docdepth/render/triangles.hpp"

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/render/depth_hypotheses.hpp"
#include "docdepth/render/raster.hpp"

namespace docdepth {
namespace {

struct DrawStrip {
  DOCDEPTH_KERNEL static void run(const Camera& camera, const MeshScene& scene, Strip& strip) {
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
    for (const PlacedDynamicObject& object : scene.dynamic_objects) {
      bool seen = false;  // as long as it is false both images are empty
      for (const PlacedMesh& mesh : object.trusted) seen |= draw_mesh(camera, mesh, strip);
      std::swap(trusted, strip.inverse_depth);
      for (const PlacedMesh& mesh : object.others) seen |= draw_mesh(camera, mesh, strip);
      if (!seen) continue;
      add_dynamic_object(columns, camera, trusted, strip.inverse_depth, object.rays, inverse_depth);
      std::fill(trusted.begin(), trusted.end(), 0.0f);
      std::fill(strip.inverse_depth.begin(), strip.inverse_depth.end(), 0.0f);
    }
    strip.inverse_depth = std::move(inverse_depth);
  }
};

}  // namespace

std::vector<float> render_triangles(const Camera& camera, const MeshScene& scene, int threads) {
  std::vector<float> depth(std::size_t(camera.width) * camera.height);
  parallel_for(camera.width, kStrip, threads, [&](std::size_t begin, std::size_t end) {
    Strip strip(static_cast<int>(begin), static_cast<int>(end), camera.height);
    dispatch<DrawStrip>(camera, scene, strip);
    for (int v = 0; v < camera.height; ++v)
      for (int u = strip.begin; u < strip.end; ++u) {
        const float w = strip.inverse_depth[std::size_t(v) * Strip::kStride + (u - strip.begin)];
        depth[std::size_t(v) * camera.width + u] =
            w > 0 ? 1.0f / w : std::numeric_limits<float>::quiet_NaN();
      }
  });
  return depth;
}

}  // namespace docdepth
