// Points, poses and classes. Metres, radians, right-handed frames.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>

namespace docdepth {

/// N points of a sweep, float32, row after row: a numpy array of shape (N, 3) without a copy.
using Points = Eigen::Ref<const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>>;

/// T_a_b takes points from frame b to frame a.
using Pose = Eigen::Isometry3d;

/// Class of a point, as frames/*.ply store it (`classid`).
enum ClassId : std::uint16_t { kGround = 0, kStatic = 50, kDynamic = 100 };

/// The class of a `classid` as a byte: below 50 ground, below 100 static, else dynamic.
inline std::uint8_t class_of(std::uint16_t classid) {
  return classid < kStatic ? kGround : classid < kDynamic ? kStatic : kDynamic;
}

}  // namespace docdepth
