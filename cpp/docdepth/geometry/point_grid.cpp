#include "docdepth/geometry/point_grid.hpp"

namespace docdepth {
namespace {

/// Edge of a cell [m]: about the distance of points that match.
constexpr double kCellSize = 0.3;
/// More cells along an axis than this would cost more than they save.
constexpr double kMaxCells = 100;

}  // namespace

PointGrid::PointGrid(const SampledPoints& points) {
  if (points.empty()) return;
  const Extent box = extent_of(points);
  const Eigen::Vector2d sides = (box.high - box.low).head<2>().cast<double>();
  low_ = box.low.head<2>().cast<double>();
  size_ = std::max(kCellSize, sides.maxCoeff() / kMaxCells);
  columns_ = 1 + int(sides.x() / size_);
  rows_ = 1 + int(sides.y() / size_);
  std::vector<std::uint32_t> cells;
  begin_.assign(std::size_t(columns_) * std::size_t(rows_) + 1, 0);
  for (const Eigen::Vector3f& p : points) {
    const int row = cell(p.y() - low_.y(), rows_), column = cell(p.x() - low_.x(), columns_);
    cells.push_back(std::uint32_t(row * columns_ + column));
    ++begin_[cells.back() + 1];
  }
  for (std::size_t k = 1; k < begin_.size(); ++k) begin_[k] += begin_[k - 1];
  points_.resize(points.size());
  indices_.resize(points.size());
  std::vector<std::uint32_t> next(begin_.begin(), begin_.end() - 1);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const std::uint32_t to = next[cells[i]]++;
    points_[to] = points[i];
    indices_[to] = std::uint32_t(i);
  }
}

}  // namespace docdepth
