// The pinhole camera of a depth map, and what it sees.
#pragma once

#include <array>

#include "docdepth/geometry/types.hpp"
#include "docdepth/render/constants.hpp"

namespace docdepth {

/// OpenCV camera (x right, y down, z forward); integer pixel coordinates are pixel centres.
struct Camera {
  double fx, fy, cx, cy;  ///< pixels
  int width, height;
};

/// The ray of a pixel, with a depth of 1.
inline Eigen::Vector3f ray_of(const Camera& camera, float u, float v) {
  return {(u - float(camera.cx)) / float(camera.fx), (v - float(camera.cy)) / float(camera.fy), 1};
}

/// An axis-aligned box.
struct Box {
  Eigen::Vector3f center = Eigen::Vector3f::Zero();
  Eigen::Vector3f extent = Eigen::Vector3f::Zero();  ///< half the edges

  /// By its corners, a millimetre larger, since center and extent are rounded.
  static Box around(const Eigen::Vector3f& low, const Eigen::Vector3f& high) {
    return {(low + high) / 2, (high - low) / 2 + Eigen::Vector3f::Constant(1e-3f)};
  }
};

/// Pixels [begin_u, end_u) x [begin_v, end_v) of an image.
struct PixelBounds {
  int begin_u = 0, end_u = 0, begin_v = 0, end_v = 0;

  bool empty() const { return begin_u >= end_u || begin_v >= end_v; }
  PixelBounds unite(const PixelBounds& other) const;
  PixelBounds intersect(const PixelBounds& other) const;
};

/// Bounds of the pixels that may show something of a box; all of the image if it reaches behind the
/// near plane.
PixelBounds bounds_of(const Camera& camera, const Pose& T_camera_box, const Box& box);

/// The five planes of a camera's view, in the frame of the points.
class Frustum {
 public:
  /// @param margin  pixels beyond the border that count as visible; at least one, so that rounding
  ///   cannot hide a point that projects into the image
  Frustum(const Camera& camera, const Pose& T_camera_points, double margin = 1.0);

  /// False only if no point of the box is visible.
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
