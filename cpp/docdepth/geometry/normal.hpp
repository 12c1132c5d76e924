// The normal of a neighbourhood.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace docdepth {

/// Eigenvector of a symmetric matrix for the eigenvalue `value`: the longest cross product of two
/// rows of (matrix - value); zero if it is not unique.
inline Eigen::Vector3d eigenvector(const Eigen::Matrix3d& matrix, double value) {
  Eigen::Matrix3d rows = matrix;
  rows.diagonal().array() -= value;
  const Eigen::Vector3d a = rows.row(0), b = rows.row(1), c = rows.row(2);
  Eigen::Vector3d best = a.cross(b);
  for (const Eigen::Vector3d& other : {Eigen::Vector3d(a.cross(c)), Eigen::Vector3d(b.cross(c))})
    if (other.squaredNorm() > best.squaredNorm()) best = other;
  const double squared = best.squaredNorm();
  return squared > 1e-30 ? Eigen::Vector3d(best / std::sqrt(squared)) : Eigen::Vector3d::Zero();
}

/// Unit eigenvector of the smallest eigenvalue of a covariance matrix, zero for points on a line.
///
/// Newton's method climbs from 0 to the smallest root of the characteristic polynomial, which is
/// concave up to there; the Rayleigh quotient then removes the rounding.
inline Eigen::Vector3d smallest_eigenvector(const Eigen::Matrix3d& covariance) {
  const double trace = covariance.trace();
  if (!(trace > 0.0)) return Eigen::Vector3d::Zero();
  const Eigen::Matrix3d m = covariance / trace;
  const double xy = m(0, 1), xz = m(0, 2), yz = m(1, 2);
  const double minors =
      (m(0, 0) * m(1, 1) - xy * xy) + (m(0, 0) * m(2, 2) - xz * xz) + (m(1, 1) * m(2, 2) - yz * yz);
  const double determinant = m(0, 0) * (m(1, 1) * m(2, 2) - yz * yz) -
                             xy * (xy * m(2, 2) - yz * xz) + xz * (xy * yz - m(1, 1) * xz);
  double value = 0.0;
  for (int i = 0; i < 30; ++i) {
    const double slope = (3.0 * value - 2.0) * value + minors;
    const double height = ((value - 1.0) * value + minors) * value - determinant;
    const double step = -height / slope;
    if (!(step > 1e-15)) break;
    value += step;
  }
  const Eigen::Vector3d normal = eigenvector(m, value);
  return eigenvector(m, normal.dot(m * normal));
}

}  // namespace docdepth
