// The pinhole camera that depth maps are drawn for, and what it cannot see.
#pragma once

#include <array>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// OpenCV camera (x right, y down, z forward); integer pixel coordinates are pixel centres.
struct Camera {
  double fx, fy, cx, cy;  ///< pixels
  int width, height;
};

/// Points nearer to the image plane than this are not drawn, metres.
constexpr float kNear = 0.1f;

/// An axis-aligned box.
struct Box {
  Eigen::Vector3f center = Eigen::Vector3f::Zero();
  Eigen::Vector3f extent = Eigen::Vector3f::Zero();  ///< half the edges
};

/// The five planes around what a camera sees, in the frame of the points that are asked for.
class Frustum {
 public:
  /// `margin` pixels beyond the border still count as seen. It is at least one here, so that
  /// rounding cannot hide a point that projects into the image.
  Frustum(const Camera& camera, const Pose& T_camera_points, double margin = 1.0);

  /// False only if no point of the box can be seen.
  bool touches(const Box& box) const {
    for (const auto& plane : planes_) {
      const Eigen::Vector3f normal = plane.head<3>();
      if (normal.dot(box.center) + normal.cwiseAbs().dot(box.extent) + plane.w() < 0) return false;
    }
    return true;
  }

 private:
  std::array<Eigen::Vector4f, 5> planes_;
};

}  // namespace docdepth
