#include "docdepth/render/surfaces.hpp"

#include <cmath>

#include "docdepth/render/edges.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// A diamond around a return, across the line of sight.
void add_diamond(const Vector& p, float angle, std::vector<Vector>& vertices,
                 Triangles& triangles) {
  const float across = std::hypot(p.x(), p.y());
  const Vector left = across > 0 ? Vector(-p.y() / across, p.x() / across, 0) : Vector(0, 1, 0);
  const Vector side = left * (angle * p.norm()), up = p.cross(left) * angle;
  const auto first = static_cast<std::uint32_t>(vertices.size());
  for (const Vector& corner : {side, up, Vector(-side), Vector(-up)})
    vertices.push_back(p + corner);
  triangles.push_back({first, first + 1, first + 2});
  triangles.push_back({first, first + 2, first + 3});
}

}  // namespace

SurfaceFrame::SurfaceFrame(const Points& points, const std::uint32_t (*triangles)[3],
                           const std::uint8_t* cut, std::size_t triangle_count,
                           const std::uint32_t* loose, std::size_t loose_count, float loose_angle,
                           const std::uint16_t* classid) {
  PartedSurface surface = part_surface(points, triangles, cut, triangle_count, classid);
  for (std::size_t i = 0; i < loose_count; ++i) {
    auto& parts = classid[loose[i]] >= kDynamic ? surface.moving : surface.fixed;
    add_diamond(points.row(loose[i]), loose_angle, surface.vertices, parts.whole);
  }
  fixed = {Mesh(surface.vertices, surface.fixed.whole),
           Mesh(surface.vertices, surface.fixed.split)};
  moving = {Mesh(surface.vertices, surface.moving.whole),
            Mesh(surface.vertices, surface.moving.split)};
}

std::vector<Layer> surface_layers(const std::vector<PlacedSurface>& fixed,
                                  const PlacedSurface& moving) {
  std::vector<Layer> layers;
  for (const auto& [frame, pose] : fixed) layers.push_back({{{&frame->fixed.whole, pose}}});
  if (!fixed.empty()) layers.push_back({{{&fixed[0].frame->fixed.split, fixed[0].T_camera_frame}}});
  const auto& parts = moving.frame->moving;
  layers.push_back(
      {{{&parts.whole, moving.T_camera_frame}, {&parts.split, moving.T_camera_frame}}, true});
  return layers;
}

std::vector<float> render_surfaces(const Camera& camera, const std::vector<PlacedSurface>& fixed,
                                   const PlacedSurface& moving, int threads) {
  return render_triangles(camera, surface_layers(fixed, moving), threads);
}

}  // namespace docdepth
