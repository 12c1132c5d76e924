#include "docdepth/render/field_of_view.hpp"

#include <algorithm>
#include <limits>
#include <utility>

#include "docdepth/mesh/directions.hpp"
#include "docdepth/render/constants.hpp"

namespace docdepth {
namespace {

constexpr int kColumns = 1024;
constexpr std::int32_t kCell = kTurn / kColumns;  // [units]
static_assert(kCell * kRadiansPerUnit < kViewGap, "a column is wider than a gap");
constexpr double kNone = -std::numeric_limits<double>::infinity();

int column_of(const Direction& d) {
  return std::min((d.azimuth + kTurn / 2) / kCell, kColumns - 1);
}

/// The column after the widest gap, and the number of columns up to that gap again.
std::pair<int, int> outside_widest_gap(const std::vector<double>& highest) {
  int empty = 0, widest = 0, first = 0;
  for (int k = 0; k < 2 * kColumns; ++k) {
    empty = highest[k % kColumns] == kNone ? empty + 1 : 0;
    if (empty > widest) widest = empty, first = (k + 1) % kColumns;
  }
  return {first, kColumns - std::min(widest, kColumns)};
}

/// Raise the values of some columns to their convex hull.
void raise_to_hull(std::vector<double>& values, int first, int count) {
  const auto at = [&](int k) -> double& { return values[(first + k) % kColumns]; };
  std::vector<int> hull;
  for (int k = 0; k < count; ++k) {
    if (at(k) == kNone) continue;
    for (; hull.size() > 1; hull.pop_back()) {
      const int a = hull[hull.size() - 2], b = hull.back();
      if ((at(b) - at(a)) * (k - a) > (at(k) - at(a)) * (b - a)) break;
    }
    hull.push_back(k);
  }
  for (std::size_t i = 1; i < hull.size(); ++i) {
    const int a = hull[i - 1], b = hull[i];
    for (int k = a + 1; k < b; ++k) at(k) = at(a) + (at(b) - at(a)) * (k - a) / (b - a);
  }
}

}  // namespace

FieldOfView::FieldOfView(const Points& points, const Points* ray_origins)
    : depth_below_(kColumns, kNone), height_above_(kColumns, kNone) {
  using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;
  const std::vector<Direction> directions =
      ray_origins ? directions_of(Matrix(points - *ray_origins)) : directions_of(points);
  const float least = ray_origins ? 0 : kViewRange;
  double lowest = kNone, highest = kNone;
  for (const bool near : {false, true})
    for (Eigen::Index i = 0; i < points.rows(); ++i) {
      const float squared = points.row(i).squaredNorm();
      if (!(squared > 0 && squared < kMaxRange * kMaxRange)) continue;  // also NaN
      if ((squared < least * least) != near) continue;
      const Direction& d = directions[i];
      lowest = std::max(lowest, -double(d.elevation));
      double& below = depth_below_[column_of(d)];
      double& above = height_above_[column_of(d)];
      if (near && above == kNone) continue;
      below = std::max(below, -double(d.elevation));
      if (near) continue;
      highest = std::max(highest, double(d.elevation));
      above = std::max(above, double(d.elevation));
    }
  const auto [first, count] = outside_widest_gap(height_above_);
  if (kColumns - count < kColumns / 4) {
    std::fill(depth_below_.begin(), depth_below_.end(), lowest);
    std::fill(height_above_.begin(), height_above_.end(), highest);
    return;
  }
  raise_to_hull(depth_below_, first, count);
  raise_to_hull(height_above_, first, count);
}

bool FieldOfView::covers(const Eigen::Vector3f& point) const {
  if (!(point.squaredNorm() < kMaxRange * kMaxRange)) return false;  // also NaN
  const Direction d = direction_of(point.x(), point.y(), point.z());
  const int column = column_of(d);
  return -double(d.elevation) <= depth_below_[column] && d.elevation <= height_above_[column];
}

}  // namespace docdepth
