#include "docdepth/render/field_of_view.hpp"

#include <algorithm>

#include "docdepth/mesh/directions.hpp"
#include "docdepth/render/constants.hpp"

namespace docdepth {
namespace {

constexpr std::int32_t kCell = kTurn / 1024;  // [units]
constexpr int kColumns = kTurn / kCell, kRows = kColumns / 2 + 1;
static_assert(3 * kCell * kRadiansPerUnit < kViewGap, "cells beside a return are no gap");

int column_of(const Direction& d) {
  return (d.azimuth + kTurn / 2) / kCell;
}
int row_of(const Direction& d) {
  return (d.elevation + kTurn / 4) / kCell;
}

/// Whether no quarter of the turn is without a return.
bool looks_all_around(const std::vector<std::uint8_t>& columns) {
  int empty = 0, widest = 0;
  for (int k = 0; k < 2 * kColumns; ++k) {
    empty = columns[k % kColumns] ? 0 : empty + 1;
    widest = std::max(widest, empty);
  }
  return widest < kColumns / 4;
}

}  // namespace

FieldOfView::FieldOfView(const Points& points, const Points* ray_origins) {
  using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;
  const std::vector<Direction> directions =
      ray_origins ? directions_of(Matrix(points - *ray_origins)) : directions_of(points);
  std::vector<Direction> all, far;
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const float squared = points.row(i).squaredNorm();
    if (!(squared > 0 && squared < kMaxRange * kMaxRange)) continue;  // also NaN
    all.push_back(directions[i]);
    if (squared > kViewRange * kViewRange) far.push_back(directions[i]);
  }
  const std::vector<Direction>& returns = ray_origins || far.empty() ? all : far;
  std::vector<std::uint8_t> columns(kColumns, 0);
  for (const Direction& d : returns) {
    columns[column_of(d)] = 1;
    low_ = std::min(low_, d.elevation), high_ = std::max(high_, d.elevation);
  }
  if (looks_all_around(columns)) return;
  looked_.assign(std::size_t(kColumns) * kRows, 0);
  for (const Direction& d : returns)
    for (const int beside : {-1, 0, 1}) {
      const int column = (column_of(d) + beside + kColumns) % kColumns, row = row_of(d);
      for (int k = std::max(row - 1, 0); k <= std::min(row + 1, kRows - 1); ++k)
        looked_[std::size_t(column) * kRows + k] = 1;
    }
}

bool FieldOfView::covers(const Eigen::Vector3f& point) const {
  if (!(point.squaredNorm() < kMaxRange * kMaxRange)) return false;  // also NaN
  const Direction d = direction_of(point.x(), point.y(), point.z());
  if (looked_.empty()) return d.elevation >= low_ && d.elevation <= high_;
  return looked_[std::size_t(column_of(d)) * kRows + row_of(d)];
}

}  // namespace docdepth
