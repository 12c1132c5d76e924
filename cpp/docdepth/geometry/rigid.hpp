// Rigid transforms with the same rounding on every processor.
#pragma once

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// T_a_b in single precision, applied in a fixed order of operations: ((r0 x + r1 y) + r2 z) + t.
/// Without fused operations (CMakeLists.txt) every processor, vector width and numpy give the same
/// bits, so fast paths can be tested for equality.
struct RigidTransform {
  float r[3][3];
  float t[3];

  explicit RigidTransform(const Pose& T_a_b) {
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) r[i][j] = static_cast<float>(T_a_b.linear()(i, j));
      t[i] = static_cast<float>(T_a_b.translation()(i));
    }
  }

  Eigen::Vector3f operator*(const Eigen::Vector3f& p) const {
    return {row(0, p), row(1, p), row(2, p)};
  }

 private:
  float row(int i, const Eigen::Vector3f& p) const {
    return ((r[i][0] * p.x() + r[i][1] * p.y()) + r[i][2] * p.z()) + t[i];
  }
};

/// T_a_b of two poses in the same world, in double precision and a fixed order of operations.
inline Pose between(const Pose& T_world_a, const Pose& T_world_b) {
  const auto a = T_world_a.linear();
  const auto dot = [&](int i, const Eigen::Vector3d& v) {
    return (a(0, i) * v(0) + a(1, i) * v(1)) + a(2, i) * v(2);
  };
  const auto column = [&](const Eigen::Vector3d& v) {
    return Eigen::Vector3d(dot(0, v), dot(1, v), dot(2, v));
  };
  Pose T_a_b = Pose::Identity();
  for (int j = 0; j < 3; ++j) T_a_b.linear().col(j) = column(T_world_b.linear().col(j));
  T_a_b.translation() = column(T_world_b.translation() - T_world_a.translation());
  return T_a_b;
}

}  // namespace docdepth
