// Normal of a neighbourhood.
#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>

namespace docdepth {

/// Unit eigenvector of the smallest eigenvalue of a covariance matrix.
inline Eigen::Vector3d smallest_eigenvector(const Eigen::Matrix3d& covariance) {
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(covariance).eigenvectors().col(0);
}

}  // namespace docdepth
