#include "docdepth/odometry/oriented_points.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <bit>
#include <cstdint>
#include <limits>

#include "docdepth/geometry/kd_tree.hpp"
#include "docdepth/geometry/parallel.hpp"

namespace docdepth {
namespace {

/// Points that a thread takes at once.
constexpr std::size_t kNormalsAtOnce = 256;
/// Fewer points form no plane.
constexpr std::size_t kFewest = 5;

/// The nearest points so far by distance, which nanoflann's search adds. It takes a quarter off the
/// time of nanoflann's own: distance and row are one number, which is moved at once.
class Nearest {
 public:
  using DistanceType = float;
  using IndexType = std::uint32_t;

  explicit Nearest(std::size_t most) : most_(most), items_(most + 1) { clear(); }

  void clear() {
    count_ = 0;
    items_[most_ - 1] = packed(std::numeric_limits<float>::max(), 0);
  }
  bool addPoint(float squared, std::uint32_t row) {
    const std::uint64_t item = packed(squared, row);
    std::size_t i = count_;
    for (; i > 0 && items_[i - 1] >> 32 > item >> 32; --i) items_[i] = items_[i - 1];
    items_[i] = item;
    count_ = std::min(count_ + 1, most_);
    return true;
  }
  void sort() {}  // they are; nanoflann 1.6 asks for it
  bool full() const { return count_ == most_; }
  bool empty() const { return count_ == 0; }
  std::size_t size() const { return count_; }
  float worstDist() const { return std::bit_cast<float>(std::uint32_t(items_[most_ - 1] >> 32)); }
  std::uint32_t row(std::size_t i) const { return static_cast<std::uint32_t>(items_[i]); }

 private:
  /// Bits of floats that are not negative are in the order of their values.
  static std::uint64_t packed(float squared, std::uint32_t row) {
    return std::uint64_t{std::bit_cast<std::uint32_t>(squared)} << 32 | row;
  }

  std::size_t most_, count_ = 0;
  std::vector<std::uint64_t> items_;
};

/// Normal of the plane through some points.
Eigen::Vector3f normal_of(const std::vector<Eigen::Vector3f>& points, const Nearest& nearest) {
  // From one of the points: far from the origin, the squares would lose what tells the plane.
  const Eigen::Vector3f origin = points[nearest.row(0)];
  const std::size_t count = nearest.size();
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Matrix3d outer = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector3d p = (points[nearest.row(i)] - origin).cast<double>();
    sum += p;
    for (int column = 0; column < 3; ++column)  // the solver reads no more
      for (int row = column; row < 3; ++row) outer(row, column) += p[row] * p[column];
  }
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
  solver.computeDirect(outer - sum * sum.transpose() / static_cast<double>(count));
  return solver.eigenvectors().col(0).cast<float>();
}

}  // namespace

OrientedPoints with_normals(const Points& points, int neighbors, int threads) {
  OrientedPoints cloud;
  cloud.points.resize(static_cast<std::size_t>(points.rows()));
  for (std::size_t i = 0; i < cloud.points.size(); ++i)
    cloud.points[i] = points.row(static_cast<Eigen::Index>(i)).transpose();
  cloud.normals.assign(cloud.points.size(), Eigen::Vector3f::Zero());
  if (cloud.points.size() < kFewest) return cloud;
  const PointsAdaptor adaptor(points);
  const KdTree tree(3, adaptor, {kTreeLeafSize});
  parallel_for(cloud.points.size(), kNormalsAtOnce, threads,
               [&](std::size_t begin, std::size_t end) {
                 Nearest nearest(static_cast<std::size_t>(neighbors));
                 for (std::size_t i = begin; i < end; ++i) {
                   nearest.clear();
                   tree.findNeighbors(nearest, cloud.points[i].data(), {});
                   if (nearest.size() >= kFewest)
                     cloud.normals[i] = normal_of(cloud.points, nearest);
                 }
               });
  return cloud;
}

}  // namespace docdepth
