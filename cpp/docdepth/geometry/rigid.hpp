// Moving points between frames with the same rounding everywhere.
#pragma once

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// T_a_b as single precision rows, applied in one fixed order of operations:
/// ((r0 x + r1 y) + r2 z) + t. With contraction off (CMakeLists.txt) every processor, every vector
/// width and numpy give the same bits, which is what lets fast paths be tested for equality.
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

}  // namespace docdepth
