#include "docdepth/odometry/gaussian_voxel_map.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/sampled_points.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3d;
using Matrix = Eigen::Matrix3d;

/// Points that a thread takes at once. Sums of blocks are added in order.
constexpr std::size_t kBlock = 2048;
/// Points whose voxels are fetched at once. They lie all over the memory, and half of the time was
/// spent on waiting for one after the other.
constexpr std::size_t kFetched = 64;
/// Fewer points do not hold a pose.
constexpr int kFewestInliers = 10;

struct Cell {
  std::int64_t x = 0, y = 0, z = 0;

  Cell() = default;
  Cell(const Vector& p, double edge)
      : x(floor(p.x() / edge)), y(floor(p.y() / edge)), z(floor(p.z() / edge)) {}
  std::uint64_t key() const { return voxel_key(x, y, z); }
  Vector corner(double edge) const { return edge * Vector(double(x), double(y), double(z)); }

 private:
  static std::int64_t floor(double value) {
    const auto whole = static_cast<std::int64_t>(value);
    return whole - (static_cast<double>(whole) > value);
  }
};

/// A point whose voxel is in the map.
struct Placed {
  Vector arm;  ///< from the sensor, about the axes of the map
  Cell cell;
  std::uint32_t voxel;
  std::size_t point;
};

}  // namespace

/// What the points of a cloud say at a pose.
struct GaussianVoxelMap::Sums {
  Eigen::Matrix<double, 6, 6> hessian = Eigen::Matrix<double, 6, 6>::Zero();
  Eigen::Matrix<double, 6, 1> gradient = Eigen::Matrix<double, 6, 1>::Zero();
  int inliers = 0;
};

void GaussianVoxelMap::insert(const OrientedPoints& cloud, const Pose& T_map_cloud) {
  ++insertions_;
  const double edge = options_.voxel_size, flat = 1 - options_.flatness;
  for (std::size_t i = 0; i < cloud.points.size(); ++i) {
    const Vector p = T_map_cloud * cloud.points[i].cast<double>();
    const Vector n = T_map_cloud.linear() * cloud.normals[i].cast<double>();
    const Cell cell(p, edge);
    const std::uint32_t number = number_of_[cell.key()];
    if (number == voxels_.size()) voxels_.emplace_back().key = cell.key();
    Voxel& voxel = voxels_[number];
    voxel.count += 1;
    voxel.sum += p - cell.corner(edge);
    voxel.covariance += Matrix::Identity() - flat * n * n.transpose();
    voxel.touched = insertions_;
  }
  if (insertions_ % options_.insertions_apart == 0) forget();
}

void GaussianVoxelMap::forget() {
  const int oldest = insertions_ - options_.forget_after;
  const auto end = std::remove_if(voxels_.begin(), voxels_.end(),
                                  [&](const Voxel& voxel) { return voxel.touched <= oldest; });
  if (end == voxels_.end()) return;
  voxels_.erase(end, voxels_.end());
  number_of_ = KeyNumbers(voxels_.size());
  for (const Voxel& voxel : voxels_) number_of_[voxel.key];
}

GaussianVoxelMap::Sums GaussianVoxelMap::sums(const OrientedPoints& cloud, std::size_t begin,
                                              std::size_t end, const Pose& pose) const {
  Sums sums;
  const double edge = options_.voxel_size, flat = 1 - options_.flatness;
  const double farthest = options_.max_distance * options_.max_distance;
  const double near = options_.tolerance * options_.tolerance;
  const double spread = options_.angle_noise * options_.angle_noise;
  const Matrix R = pose.linear();
  const Vector t = pose.translation();
  Matrix turns = Matrix::Zero(), mixed = Matrix::Zero(), shifts = Matrix::Zero();
  Vector torque = Vector::Zero(), force = Vector::Zero();
  const auto add = [&](const Placed& placed) {
    const Vector &arm = placed.arm, p = arm + t;
    const Voxel& voxel = voxels_[placed.voxel];
    const double share = 1 / voxel.count;
    const Vector off = placed.cell.corner(edge) + share * voxel.sum - p;
    if (off.squaredNorm() > farthest) return;
    const Vector n = R * cloud.normals[placed.point].cast<double>();
    const Matrix covariance =
        share * voxel.covariance + Matrix::Identity() - flat * n * n.transpose();
    Matrix weight = covariance.inverse();
    // Both flat variances: that of the voxel and that of the point.
    const double squared = 2 * options_.flatness * off.dot(weight * off);
    weight /= 1 + squared / (near + spread * arm.squaredNorm());
    Matrix cross;  // [arm]x
    cross << 0, -arm.z(), arm.y(), arm.z(), 0, -arm.x(), -arm.y(), arm.x(), 0;
    const Matrix lever = cross * weight;
    const Vector pull = weight * off;
    turns -= lever * cross;
    mixed += lever;
    shifts += weight;
    torque -= arm.cross(pull);
    force -= pull;
    ++sums.inliers;
  };
  std::array<Placed, kFetched> some;
  for (std::size_t first = begin; first < end; first += kFetched) {
    std::size_t count = 0;
    for (std::size_t i = first; i < std::min(first + kFetched, end); ++i) {
      const Vector arm = R * cloud.points[i].cast<double>();
      const Cell cell(arm + t, edge);
      const std::uint32_t number = number_of_.find(cell.key());
      if (number == KeyNumbers::kNone) continue;
      const auto* voxel = reinterpret_cast<const char*>(&voxels_[number]);
      for (std::size_t byte = 0; byte < sizeof(Voxel); byte += 64) __builtin_prefetch(voxel + byte);
      some[count++] = {arm, cell, number, i};
    }
    for (std::size_t k = 0; k < count; ++k) add(some[k]);
  }
  sums.hessian << turns, mixed, mixed.transpose(), shifts;
  sums.gradient << torque, force;
  return sums;
}

Alignment GaussianVoxelMap::align(const OrientedPoints& cloud, const Pose& guess,
                                  int threads) const {
  const std::size_t count = cloud.points.size();
  std::vector<Sums> of_block((count + kBlock - 1) / kBlock);
  Alignment found;
  found.T_map_cloud = guess;
  for (int iteration = 0; iteration < options_.max_iterations; ++iteration) {
    parallel_for(count, kBlock, threads, [&](std::size_t begin, std::size_t end) {
      of_block[begin / kBlock] = sums(cloud, begin, end, found.T_map_cloud);
    });
    Sums all;
    for (const Sums& block : of_block) {
      all.hessian += block.hessian;
      all.gradient += block.gradient;
      all.inliers += block.inliers;
    }
    found.hessian = all.hessian;
    found.inliers = all.inliers;
    if (all.inliers < kFewestInliers) break;
    const Eigen::Matrix<double, 6, 1> step = -all.hessian.ldlt().solve(all.gradient);
    const Vector turn = step.head<3>(), shift = step.tail<3>();
    const double angle = turn.norm();
    if (angle > 0)
      found.T_map_cloud.linear() =
          Eigen::AngleAxisd(angle, turn / angle) * Matrix(found.T_map_cloud.linear());
    found.T_map_cloud.translation() += shift;
    if (angle < options_.min_turn && shift.norm() < options_.min_shift) break;
  }
  return found;
}

}  // namespace docdepth
