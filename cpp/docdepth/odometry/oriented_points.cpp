#include "docdepth/odometry/oriented_points.hpp"

#include <Eigen/Eigenvalues>
#include <cstdint>

#include "docdepth/geometry/kd_tree.hpp"
#include "docdepth/geometry/parallel.hpp"

namespace docdepth {
namespace {

/// Points that a thread takes at once.
constexpr std::size_t kNormalsAtOnce = 256;
/// Fewer points form no plane.
constexpr std::size_t kFewest = 5;

/// Normal of the plane through the first of some rows.
Eigen::Vector3f normal_of(const std::vector<Eigen::Vector3f>& points,
                          const std::vector<std::uint32_t>& rows, std::size_t count) {
  // From one of the points: far from the origin, the squares would lose what tells the plane.
  const Eigen::Vector3f origin = points[rows[0]];
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Matrix3d outer = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector3d p = (points[rows[i]] - origin).cast<double>();
    sum += p;
    outer += p * p.transpose();
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
                 std::vector<std::uint32_t> nearest(static_cast<std::size_t>(neighbors));
                 std::vector<float> squared(nearest.size());
                 for (std::size_t i = begin; i < end; ++i) {
                   const std::size_t count = tree.knnSearch(cloud.points[i].data(), nearest.size(),
                                                            nearest.data(), squared.data());
                   if (count >= kFewest) cloud.normals[i] = normal_of(cloud.points, nearest, count);
                 }
               });
  return cloud;
}

}  // namespace docdepth
