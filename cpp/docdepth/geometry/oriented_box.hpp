// A box that is turned as an object is.
#pragma once

#include "docdepth/geometry/types.hpp"

namespace docdepth {

struct OrientedBox {
  Eigen::Isometry3f T_box_world;  ///< x forward, z up; the origin is the middle of the box
  Eigen::Vector3f half;           ///< half of its length, width and height [m]

  /// Whether a point lies in the box or at most `margin` beside it [m].
  bool contains(const Eigen::Vector3f& point, float margin) const {
    const Eigen::Vector3f p = T_box_world * point;
    return (p.array().abs() <= half.array() + margin).all();
  }
  Eigen::Vector3f middle() const { return T_box_world.inverse().translation(); }
};

}  // namespace docdepth
