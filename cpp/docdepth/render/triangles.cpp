#include "docdepth/render/triangles.hpp"

#include <algorithm>
#include <utility>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/render/behind_boxes.hpp"
#include "docdepth/render/depth_hypotheses.hpp"
#include "docdepth/render/raster.hpp"
#include "docdepth/render/straight_outlines.hpp"

namespace docdepth {
namespace {

/// Draw dynamic objects over what is farther. The strip is left empty.
DOCDEPTH_KERNEL void draw_dynamic_objects(const Camera& camera,
                                          const std::vector<DynamicObjectScene>& objects,
                                          const Columns& columns, Strip& strip,
                                          std::vector<float>& inverse_depth,
                                          std::vector<std::uint16_t>& shown_objects) {
  const PixelBounds own{strip.begin, strip.end, 0, strip.height};
  const std::vector<float> none(inverse_depth.size(), 0.0f);
  ObjectImages images{none, none, none};
  std::fill(strip.inverse_depth.begin(), strip.inverse_depth.end(), 0.0f);
  std::uint16_t number = 0;
  for (const DynamicObjectScene& object : objects) {
    ++number;
    PixelBounds bounds = object.bounds.intersect(own);
    if (bounds.empty()) continue;
    bounds.begin_u -= strip.begin;
    bounds.end_u -= strip.begin;
    bool seen = false;  // as long as it is false all images are empty
    for (const auto& [meshes, image] :
         {std::pair(&object.nearest, &images.nearest), std::pair(&object.others, &images.others),
          std::pair(&object.extrapolated, &images.extrapolated)}) {
      for (const PlacedMesh& mesh : *meshes) seen |= draw_mesh(camera, mesh, strip);
      std::swap(*image, strip.inverse_depth);
    }
    if (!seen) continue;
    add_dynamic_object(columns, bounds, camera, images, object.rays, number, inverse_depth,
                       shown_objects);
    for (auto* image : {&images.nearest, &images.others, &images.extrapolated})
      for (int v = bounds.begin_v; v < bounds.end_v; ++v)
        std::fill_n(image->begin() + std::ptrdiff_t(columns.at(bounds.begin_u, v)),
                    bounds.end_u - bounds.begin_u, 0.0f);
  }
}

struct DrawStrip {
  DOCDEPTH_KERNEL static void run(const Camera& camera, const MeshScene& scene, Strip& strip,
                                  std::vector<std::uint16_t>& shown_objects) {
    for (const PlacedMesh& mesh : scene.nearest) draw_mesh(camera, mesh, strip);
    const Columns columns{strip.begin, strip.end - strip.begin, strip.height, Strip::kStride};
    std::vector<float> nearest(strip.inverse_depth.size(), 0.0f);
    std::swap(nearest, strip.inverse_depth);
    for (const PlacedMesh& mesh : scene.extrapolated) draw_mesh(camera, mesh, strip);
    DepthHypotheses hypotheses(columns, std::move(nearest), strip.inverse_depth);
    strip.open_only(hypotheses);
    for (const PlacedMesh& mesh : scene.others) {
      draw_mesh(camera, mesh, strip);
      hypotheses.add(strip.inverse_depth.data());
    }
    std::vector<float> inverse_depth = hypotheses.resolve(camera, scene.rays);
    std::fill(strip.open_tiles.begin(), strip.open_tiles.end(), std::uint8_t{1});
    shown_objects.assign(scene.dynamic_objects.empty() ? 0 : inverse_depth.size(), 0);
    draw_dynamic_objects(camera, scene.dynamic_objects, columns, strip, inverse_depth,
                         shown_objects);
    strip.inverse_depth = std::move(inverse_depth);
  }
};

}  // namespace

float return_spacing(const Camera& camera, const MeshScene& scene) {
  return scene.rays.empty() ? 0 : scene.rays[0].rays->cells().spacing() * float(camera.fx);
}

std::vector<float> render_triangles(const Camera& camera, const MeshScene& scene, int threads) {
  std::vector<float> depth(std::size_t(camera.width) * camera.height);
  std::vector<std::uint16_t> shown_objects(scene.dynamic_objects.empty() ? 0 : depth.size());
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
        if (!shown_objects.empty()) shown_objects[to] = drawn[from];
      }
  });
  straighten_outlines(camera, return_spacing(camera, scene), depth, shown_objects, threads);
  mask_unobserved_background(camera, scene, shown_objects, depth, threads);
  return depth;
}

}  // namespace docdepth
