#include "docdepth/odometry/oriented_points.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "docdepth/geometry/neighborhoods.hpp"
#include "docdepth/geometry/normal.hpp"

namespace docdepth {
namespace {

/// Fewer points form no plane.
constexpr std::size_t kFewest = 5;

/// Points of two rings differ by more than this in the tangent of their elevation.
constexpr float kMinRingSpacing = 0.002f;

/// Whether points above the sensor are all of one ring. Such points lie on the cone of its rays,
/// whatever they hit: in a tree, or on a wall that is not flat, a plane through them is nearly
/// level. No such surface exists, and as it moves with the sensor, it would pull height, roll and
/// pitch. Below the sensor, the plane through a ring is mostly that of the road.
bool shows_only_its_ring(const std::vector<Eigen::Vector3f>& points,
                         const std::vector<std::uint32_t>& nearest) {
  float low = INFINITY, high = -INFINITY;
  for (const std::uint32_t row : nearest) {
    const float slope = points[row].z() / points[row].head<2>().norm();
    low = std::min(low, slope);
    high = std::max(high, slope);
    if (low < 0 || high - low >= kMinRingSpacing) return false;
  }
  return true;
}

/// Normal of the plane through some points; zero if they lie on a line or show only their ring.
Eigen::Vector3f normal_of(const std::vector<Eigen::Vector3f>& points,
                          const std::vector<std::uint32_t>& nearest) {
  if (shows_only_its_ring(points, nearest)) return Eigen::Vector3f::Zero();
  // From one of the points: far from the origin, the squares would lose what tells the plane.
  const Eigen::Vector3f origin = points[nearest[0]];
  double x = 0, y = 0, z = 0, xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;
  for (const std::uint32_t row : nearest) {
    const Eigen::Vector3d p = (points[row] - origin).cast<double>();
    x += p.x(), y += p.y(), z += p.z();
    xx += p.x() * p.x(), xy += p.x() * p.y(), xz += p.x() * p.z();
    yy += p.y() * p.y(), yz += p.y() * p.z(), zz += p.z() * p.z();
  }
  const Eigen::Vector3d sum(x, y, z);
  Eigen::Matrix3d outer;
  outer << xx, xy, xz, xy, yy, yz, xz, yz, zz;
  const auto count = static_cast<double>(nearest.size());
  return smallest_eigenvector(outer - sum * sum.transpose() / count).cast<float>();
}

}  // namespace

OrientedPoints with_normals(const Points& points, int neighbors, int threads) {
  OrientedPoints cloud;
  cloud.points.resize(static_cast<std::size_t>(points.rows()));
  for (std::size_t i = 0; i < cloud.points.size(); ++i)
    cloud.points[i] = points.row(static_cast<Eigen::Index>(i)).transpose();
  cloud.normals.assign(cloud.points.size(), Eigen::Vector3f::Zero());
  if (cloud.points.size() < kFewest) return cloud;
  for_each_neighborhood(points, neighbors, threads,
                        [&](std::uint32_t row, const std::vector<std::uint32_t>& nearest) {
                          cloud.normals[row] = normal_of(cloud.points, nearest);
                        });
  return cloud;
}

}  // namespace docdepth
