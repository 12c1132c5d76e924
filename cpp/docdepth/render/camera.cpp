#include "docdepth/render/camera.hpp"

#include <algorithm>
#include <cmath>

namespace docdepth {

PixelBounds PixelBounds::unite(const PixelBounds& other) const {
  if (empty()) return other;
  if (other.empty()) return *this;
  return {std::min(begin_u, other.begin_u), std::max(end_u, other.end_u),
          std::min(begin_v, other.begin_v), std::max(end_v, other.end_v)};
}

PixelBounds PixelBounds::intersect(const PixelBounds& other) const {
  return {std::max(begin_u, other.begin_u), std::min(end_u, other.end_u),
          std::max(begin_v, other.begin_v), std::min(end_v, other.end_v)};
}

PixelBounds bounds_of(const Camera& camera, const Pose& T_camera_box, const Box& box) {
  const PixelBounds image{0, camera.width, 0, camera.height};
  if (!Frustum(camera, T_camera_box).touches(box)) return {};
  double low_u = INFINITY, low_v = INFINITY, high_u = -INFINITY, high_v = -INFINITY;
  for (int corner = 0; corner < 8; ++corner) {
    Eigen::Vector3f p = box.center;
    for (int axis = 0; axis < 3; ++axis)
      p[axis] += (corner >> axis & 1 ? 1.0f : -1.0f) * box.extent[axis];
    const Eigen::Vector3d seen = T_camera_box * p.cast<double>();
    if (!(seen.z() > kNear)) return image;
    const double u = camera.fx * seen.x() / seen.z() + camera.cx;
    const double v = camera.fy * seen.y() / seen.z() + camera.cy;
    low_u = std::min(low_u, u);
    high_u = std::max(high_u, u);
    low_v = std::min(low_v, v);
    high_v = std::max(high_v, v);
  }
  // A pixel more on each side, since triangles are drawn with slack.
  const auto pixel = [](double at, int most) { return int(std::clamp(at, -1.0, most + 1.0)); };
  return PixelBounds{
      pixel(std::floor(low_u) - 1, camera.width), pixel(std::ceil(high_u) + 2, camera.width),
      pixel(std::floor(low_v) - 1, camera.height), pixel(std::ceil(high_v) + 2, camera.height)}
      .intersect(image);
}

Frustum::Frustum(const Camera& camera, const Pose& T_camera_points, double margin) {
  // left <= fx x / z + cx <= right, times z > 0; likewise for rows. Slack against rounding.
  const double left = -1.5 - margin, right = camera.width + 0.5 + margin;
  const double top = left, bottom = camera.height + 0.5 + margin;
  const double slack = 1e-3;
  const std::array<Eigen::Vector4d, 5> seen{{
      {0, 0, 1, -kNear},
      {camera.fx, 0, camera.cx - left, 0},
      {-camera.fx, 0, right - camera.cx, 0},
      {0, camera.fy, camera.cy - top, 0},
      {0, -camera.fy, bottom - camera.cy, 0},
  }};
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const double length = seen[i].head<3>().norm();
    const Eigen::Vector3d normal = seen[i].head<3>() / length;
    planes_[i].head<3>() = (T_camera_points.linear().transpose() * normal).cast<float>();
    planes_[i].w() = static_cast<float>(normal.dot(T_camera_points.translation()) +
                                        seen[i].w() / length + slack);
  }
}

}  // namespace docdepth
