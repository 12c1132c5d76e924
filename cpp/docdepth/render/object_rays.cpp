#include <algorithm>
#include <cmath>

#include "docdepth/mesh/directions.hpp"
#include "docdepth/render/mesh_frame.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

/// Rays that pass within this distance of an object tell where it ends [m] ...
constexpr float kOutlineReach = 1.0f;
/// ... and within this angle [rad], 2.5 degrees: more than the rings of any LiDAR are apart.
constexpr float kOutlineAngle = 0.044f;

/// Directions around an object: azimuths relative to one of its returns, so that no seam is near.
struct Around {
  Direction centre{};
  std::int32_t left = 0, right = 0, low = 0, high = 0;
  float nearest = INFINITY;  ///< range of its nearest return [m]

  std::int32_t relative(const Direction& d) const {
    const std::int32_t turn = d.azimuth - centre.azimuth;
    return turn < -kTurn / 2 ? turn + kTurn : turn >= kTurn / 2 ? turn - kTurn : turn;
  }
  void add(const Direction& d, float range) {
    left = std::min(left, relative(d));
    right = std::max(right, relative(d));
    low = std::min(low, d.elevation - centre.elevation);
    high = std::max(high, d.elevation - centre.elevation);
    nearest = std::min(nearest, range);
  }
  void widen() {
    const float angle = std::max(std::atan2(kOutlineReach, nearest), kOutlineAngle);
    const auto units = static_cast<std::int32_t>(angle / kRadiansPerUnit);
    left = std::max(left - units, -kTurn / 2);
    right = std::min(right + units, kTurn / 2 - 1);
    low -= units;
    high += units;
  }
  bool holds(const Direction& d) const {
    const std::int32_t up = d.elevation - centre.elevation;
    if (up < low || up > high) return false;
    const std::int32_t turn = relative(d);
    return left <= turn && turn <= right;
  }
};

std::vector<Around> around_objects(const MeshParts& parts, const std::vector<Direction>& directions,
                                   std::size_t objects) {
  std::vector<Around> around(objects);
  std::vector<std::uint8_t> known(objects, 0);
  for (Eigen::Index i = 0; i < parts.points.rows(); ++i) {
    const std::size_t object_index = parts.object_index[i];
    if (!object_index) continue;
    if (!known[object_index - 1]) {
      around[object_index - 1].centre = directions[i];
      known[object_index - 1] = 1;
    }
    around[object_index - 1].add(directions[i], parts.points.row(i).norm());
  }
  for (Around& one : around) one.widen();
  return around;
}

}  // namespace

std::vector<Rays> object_rays(const MeshParts& parts, const std::vector<Vector>& normals) {
  const Points& points = parts.points;
  const std::vector<Direction> directions = parts.ray_origins
                                                ? directions_of(Matrix(points - *parts.ray_origins))
                                                : directions_of(points);
  std::vector<Rays> result;
  result.reserve(parts.motions.size());
  for (const Around& around : around_objects(parts, directions, parts.motions.size())) {
    if (parts.drawn && !parts.drawn[result.size()]) {
      result.emplace_back();
      continue;
    }
    std::vector<Eigen::Index> rows;
    for (Eigen::Index i = 0; i < points.rows(); ++i)
      if (around.holds(directions[i])) rows.push_back(i);
    const ObjectMotion& motion = parts.motions[result.size()];
    Matrix ends(rows.size(), 3), origins = Matrix::Zero(ends.rows(), 3);
    std::vector<Vector> across;
    std::vector<float> times;
    std::vector<std::uint8_t> own;
    for (std::size_t k = 0; k < rows.size(); ++k) {
      const Eigen::Index i = rows[k];
      const auto to = Eigen::Index(k);
      if (parts.ray_origins) origins.row(to) = parts.ray_origins->row(i);
      ends.row(to) = points.row(i);
      across.push_back(normals[i]);
      own.push_back(parts.object_index[i] == result.size() + 1);
      times.push_back(parts.time_offset ? parts.time_offset[i] : 0.0f);
      if (!parts.time_offset) continue;
      const Vector moved = motion.velocity * (motion.time - parts.time_offset[i]);
      origins.row(to) += moved.transpose();
      ends.row(to) += moved.transpose();
    }
    std::int32_t first = around.centre.azimuth + around.left;
    if (first < -kTurn / 2) first += kTurn;
    const Points moved_origins = origins;
    result.emplace_back(ends, across, &moved_origins, Sector{first, around.right - around.left + 1},
                        times.data(), own.data());
  }
  return result;
}

}  // namespace docdepth
