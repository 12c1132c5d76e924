// Registration of sweeps on a map of voxels, distribution to distribution (VGICP).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/key_numbers.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/odometry/oriented_points.hpp"

namespace docdepth {

struct RegistrationOptions {
  double voxel_size = 1.0;    ///< edge of a voxel of the map [m]
  double max_distance = 1.0;  ///< from a point to the mean of its voxel [m]
  double flatness = 1e-3;     ///< variance across a surface over that along it
  double tolerance = 0.3;     ///< distance from a surface at which a point counts half [m]
  double angle_noise = 1e-3;  ///< of beams, and of turns while a pose is sought [rad]
  int max_iterations = 30;
  double min_turn = 1e-4;     ///< a smaller step is the last one [rad]
  double min_shift = 5e-4;    ///< [m]
  int forget_after = 100;     ///< a voxel that so many insertions do not touch is deleted
  int insertions_apart = 10;  ///< from one deletion to the next
};

struct Alignment {
  Pose T_map_cloud = Pose::Identity();
  /// Of the sum of squares, about the axes of the map: rotation, then position.
  Eigen::Matrix<double, 6, 6> hessian = Eigen::Matrix<double, 6, 6>::Zero();
  int inliers = 0;
};

/// Voxels, each a normal distribution of the points in it.
///
/// A point is as uncertain along its surface as its neighbourhood is wide, and `flatness` times
/// that across it (Segal et al., Generalized-ICP; Koide et al., Voxelized GICP). A point without a
/// normal is uncertain in all directions, and so tells next to nothing. The farther a point lies
/// from its surface, the less it counts (Cauchy's weights): half at `tolerance`, to which far
/// points add `angle_noise` of their range. So a few points of what moves do not pull a sweep
/// along.
class GaussianVoxelMap {
 public:
  explicit GaussianVoxelMap(const RegistrationOptions& options) : options_(options) {}

  void insert(const OrientedPoints& cloud, const Pose& T_map_cloud);

  /// Move a cloud from a guess to where it fits best (Gauss-Newton). The result does not depend on
  /// the number of threads.
  Alignment align(const OrientedPoints& cloud, const Pose& guess, int threads) const;

  struct Voxel {
    std::uint64_t key = 0;
    double count = 0;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();         ///< from the corner of the voxel
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< sum of those of the points
    int touched = 0;                                       ///< last insertion
  };
  const std::vector<Voxel>& voxels() const { return voxels_; }

 private:
  struct Sums;

  void forget();
  Sums sums(const OrientedPoints& cloud, std::size_t begin, std::size_t end,
            const Pose& pose) const;

  RegistrationOptions options_;
  KeyNumbers number_of_;
  std::vector<Voxel> voxels_;
  int insertions_ = 0;
};

}  // namespace docdepth
