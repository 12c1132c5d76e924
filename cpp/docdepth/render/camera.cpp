#include "docdepth/render/camera.hpp"

namespace docdepth {

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
