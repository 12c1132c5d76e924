#include <algorithm>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/render/layers.hpp"
#include "docdepth/render/shutter_rays.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// A surface may hide what is drawn within so many mean distances between returns beside it, and at
/// most so many pixels.
constexpr float kFrontRays = 2;
constexpr int kMostFront = 32;

Vector point_at(const Camera& camera, std::size_t pixel, const float* depth) {
  return ray_of(camera, float(pixel % camera.width), float(pixel / camera.width)) * depth[pixel];
}

bool all(const QuadrantRays& corners, Verdict verdict) {
  return count(corners, {verdict}) == int(corners.size());
}

/// Whether another surface, whose returns lie beside the pixel, may hide its point from the camera.
/// @param front  the nearest point of the image beside the pixel
bool may_be_hidden(const ShutterRays& rays, const Vector& point, const Vector& front,
                   const QuadrantRays& corners) {
  if (front.z() + kSurfaceMargin + kSurfaceMarginGrowth * point.z() > point.z()) return false;
  for (const QuadrantRay& corner : corners)
    if (rays.on_plane(corner, front)) return false;
  const QuadrantRays before = rays.around({front.z() / point.z() * point, Kind::kAny});
  return count(before, {Verdict::kEnded}) > 0;
}

/// The camera stands beside the sensor: what ends before the point for one of them may not hide it
/// from the other.
Seen seen_at(const ShutterRays& rays, const Vector& point, Kind kind, const Vector& front) {
  const QuadrantRays corners = rays.around({point, kind});
  if (all(corners, Verdict::kPassed)) return Seen::kContradicted;
  if (all(corners, Verdict::kEnded))
    return may_be_hidden(rays, point, front, corners) ? Seen::kNotLookedAt : Seen::kAgreed;
  if (!all(corners, Verdict::kBefore)) return Seen::kNotLookedAt;
  const QuadrantRay& nearest = *std::min_element(
      corners.begin(), corners.end(),
      [](const QuadrantRay& a, const QuadrantRay& b) { return a.squared < b.squared; });
  const bool hidden = all(rays.around({nearest.range * point, kind}), Verdict::kEnded);
  return hidden ? Seen::kContradicted : Seen::kNotLookedAt;
}

/// The pixel with the least depth within `radius` pixels to each side and up and down.
std::vector<std::uint32_t> nearest_beside(const Camera& camera, const float* depth, int radius) {
  const int width = camera.width, height = camera.height;
  std::vector<std::uint32_t> rows(std::size_t(width) * height), result(rows.size());
  const auto take = [&](std::uint32_t& kept, std::uint32_t other) {
    if (depth[other] > 0 && !(depth[kept] <= depth[other])) kept = other;
  };
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) {
      std::uint32_t& kept = rows[std::size_t(v) * width + u] = std::uint32_t(v * width + u);
      for (int k = std::max(u - radius, 0); k <= std::min(u + radius, width - 1); ++k)
        take(kept, std::uint32_t(v * width + k));
    }
  result = rows;
  for (int v = 0; v < height; ++v)
    for (int k = std::max(v - radius, 0); k <= std::min(v + radius, height - 1); ++k)
      for (int u = 0; u < width; ++u)
        take(result[std::size_t(v) * width + u], rows[std::size_t(k) * width + u]);
  return result;
}

/// A surface goes on beyond its last return for less than the distance to the next [pixel].
int front_radius(const Camera& camera, const std::vector<SweepRays>& rays) {
  float spacing = 0;
  for (const SweepRays& placed : rays) spacing = std::max(spacing, placed.rays->cells().spacing());
  return std::min(int(kFrontRays * spacing * float(camera.fx)), kMostFront);
}

}  // namespace

std::vector<Seen> seen_pixels(const Camera& camera, const MeshScene& scene, const float* depth,
                              const std::vector<std::int32_t>& objects, int threads) {
  const ShutterRays still(scene.shutter_rays);
  std::vector<ShutterRays> moved;
  for (const DynamicObjectScene& object : scene.dynamic_objects) moved.emplace_back(object.rays);
  const auto front = nearest_beside(camera, depth, front_radius(camera, scene.shutter_rays));
  std::vector<Seen> seen(objects.size(), Seen::kNoDepth);
  parallel_for(camera.height, 8, threads, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin * camera.width; i < end * camera.width; ++i) {
      if (!(depth[i] > 0)) continue;
      const std::int32_t k = objects[i];
      const ShutterRays& rays = k < 0 ? still : moved[k];
      const Kind kind = k < 0 ? Kind::kStatic : Kind::kMoving;
      seen[i] = seen_at(rays, point_at(camera, i, depth), kind, point_at(camera, front[i], depth));
    }
  });
  return seen;
}

}  // namespace docdepth
