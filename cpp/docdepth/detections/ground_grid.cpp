#include "docdepth/detections/ground_grid.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// Ground is kept as cells of this edge, so far around the LiDAR [m].
constexpr float kGroundCell = 1.0f;
constexpr float kGroundRange = 100.0f;
/// An object stands on the ground that lies this near to it [m].
constexpr float kGroundReach = 5.0f;
/// How exactly a cell tells the height at its place [m].
constexpr double kGroundDeviation = 0.1;
/// How steep ground may be [m/m].
constexpr double kGroundSlope = 0.1;
constexpr int kSide = int(2 * kGroundRange / kGroundCell);  // cells along each axis

/// How far a coordinate lies outside of an interval; 0 inside.
float outside(float value, float low, float high) {
  return std::max(std::max(low - value, value - high), 0.0f);
}

}  // namespace

GroundGrid::GroundGrid(const Points& points, const bool* ground,
                       const RigidTransform& T_world_lidar)
    : corner_{T_world_lidar.t[0] - kGroundRange, T_world_lidar.t[1] - kGroundRange},
      cells_(std::size_t(kSide) * kSide) {
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    if (!ground[i]) continue;
    const Vector p = T_world_lidar * Vector(points.row(i));
    const int x = column(p.x(), 0), y = column(p.y(), 1);
    if (x < 0 || y < 0 || x >= kSide || y >= kSide) continue;
    Cell& cell = cells_[std::size_t(x) * kSide + y];
    // Sums of differences keep their digits in single precision.
    cell.sum += p.z() - T_world_lidar.t[2];
    ++cell.points;
  }
  height_ = T_world_lidar.t[2];
}

/// Cell along an axis; those beyond the border have numbers outside of the grid.
int GroundGrid::column(float coordinate, int axis) const {
  const float cell = std::floor((coordinate - corner_[axis]) / kGroundCell);
  return int(std::clamp(cell, -1.0f, float(kSide)));
}

GroundHeight GroundGrid::under(const Extent& box) const {
  const Vector middle = 0.5f * (box.low + box.high);
  int first[2], last[2];
  for (int axis : {0, 1}) {
    first[axis] = std::max(column(box.low[axis] - kGroundReach, axis), 0);
    last[axis] = std::min(column(box.high[axis] + kGroundReach, axis), kSide - 1);
  }
  // Height under the middle, and the slopes along x and y.
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  normal(1, 1) = normal(2, 2) = 1 / (kGroundSlope * kGroundSlope);
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  for (int x = first[0]; x <= last[0]; ++x)
    for (int y = first[1]; y <= last[1]; ++y) {
      const Cell& cell = cells_[std::size_t(x) * kSide + y];
      if (cell.points == 0) continue;
      const float at_x = corner_[0] + (float(x) + 0.5f) * kGroundCell,
                  at_y = corner_[1] + (float(y) + 0.5f) * kGroundCell;
      const float away = std::hypot(outside(at_x, box.low.x(), box.high.x()),
                                    outside(at_y, box.low.y(), box.high.y()));
      const double deviation = kGroundDeviation + kGroundSlope * away;
      const Eigen::Vector3d row(1, at_x - middle.x(), at_y - middle.y());
      const double height = cell.sum / float(cell.points);
      normal += row * row.transpose() / (deviation * deviation);
      right += row * (height / (deviation * deviation));
    }
  if (normal(0, 0) == 0) return {};
  const auto factors = normal.ldlt();
  const double height = factors.solve(right)(0),
               variance = factors.solve(Eigen::Vector3d::UnitX())(0);
  // Cells err alike, so that many know no better than one.
  return {height_ + float(height),
          float(std::sqrt(variance + kGroundDeviation * kGroundDeviation))};
}

}  // namespace docdepth
