// Points that are found by their place.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "docdepth/geometry/sampled_points.hpp"

namespace docdepth {

/// Points in the cells of a grid, as seen from above. What it finds is what a look at all points
/// would find, bit for bit.
class PointGrid {
 public:
  explicit PointGrid(const SampledPoints& points);

  /// Whether a condition holds for a point near p. It is asked for each one within a horizontal
  /// distance, and for some that are farther.
  template <class Condition>
  bool any_near(const Eigen::Vector3f& p, float distance, const Condition& condition) const {
    const double reach = kReachFactor * distance;
    const auto [left, right] = cells(p.x() - low_.x(), reach, columns_);
    const auto [bottom, top] = cells(p.y() - low_.y(), reach, rows_);
    if (right < left) return false;
    for (int row = bottom; row <= top; ++row) {
      const std::size_t cell = std::size_t(row) * std::size_t(columns_);
      const auto end = begin_[cell + std::size_t(right) + 1];
      for (auto n = begin_[cell + std::size_t(left)]; n < end; ++n)
        if (condition(points_[n], indices_[n])) return true;
    }
    return false;
  }

  /// Squared distance from p to the nearest point, and its index: of equally near ones the first.
  /// It may be missed if it is farther than `distance`.
  std::pair<float, std::size_t> nearest(const Eigen::Vector3f& p, float distance) const {
    std::pair<float, std::size_t> found{std::numeric_limits<float>::infinity(), 0};
    any_near(p, distance, [&](const Eigen::Vector3f& point, std::size_t index) {
      found = std::min(found, {(point - p).squaredNorm(), index});
      return false;
    });
    return found;
  }

 private:
  /// Beyond the rounding of distances.
  static constexpr double kReachFactor = 1.0001;

  int cell(double offset, int count) const {
    const double steps = offset / size_;
    return steps > 0 ? static_cast<int>(std::min(steps, count - 1.0)) : 0;  // 0 also for NaN
  }
  /// The first and the last cell along an axis within reach of an offset.
  std::pair<int, int> cells(double offset, double reach, int count) const {
    if (offset + reach < 0 || offset - reach > count * size_) return {0, -1};
    return {cell(offset - reach, count), cell(offset + reach, count)};
  }

  Eigen::Vector2d low_ = Eigen::Vector2d::Zero();
  double size_ = 1;  ///< edge of a cell [m]
  int columns_ = 0, rows_ = 0;
  std::vector<std::uint32_t> begin_;    ///< the first point of each cell, row after row
  SampledPoints points_;                ///< cell after cell
  std::vector<std::uint32_t> indices_;  ///< of these points
};

}  // namespace docdepth
