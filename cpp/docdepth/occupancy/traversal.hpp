// The voxels along a segment (Amanatides and Woo, "A Fast Voxel Traversal Algorithm", 1987).
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <limits>

namespace docdepth {

/// Visit the voxels of a grid from one point to another, in order.
///
/// The voxel of the last point is the last one. So the number of steps along each axis is known
/// before, and rounding cannot lead past it.
/// @param from, to  in voxels from the lowest corner
/// @param visit     visit(number of the voxel, numbered row by row) tells whether to go on
template <class Visit>
void traverse(const Eigen::Vector3d& from, const Eigen::Vector3d& to,
              const std::array<int, 3>& size, const Visit& visit) {
  const Eigen::Vector3d way = to - from;
  double begin = 0, end = 1;
  for (int axis = 0; axis < 3; ++axis) {
    if (way(axis) == 0) {
      if (!(from(axis) >= 0 && from(axis) < size[axis])) return;
      continue;
    }
    const double low = -from(axis) / way(axis), high = (size[axis] - from(axis)) / way(axis);
    begin = std::max(begin, std::min(low, high)), end = std::min(end, std::max(low, high));
  }
  if (!(begin < end)) return;
  std::array<int, 3> left;               // steps
  std::array<double, 3> next, per_step;  // share of the way
  std::array<std::ptrdiff_t, 3> stride{std::ptrdiff_t(size[1]) * size[2], size[2], 1};
  std::ptrdiff_t voxel = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const auto cell = [&](double share) {
      const double at = share == 1 ? to(axis) : from(axis) + share * way(axis);
      return std::clamp(static_cast<int>(std::floor(at)), 0, size[axis] - 1);
    };
    const int first = cell(begin), last = cell(end);
    left[axis] = std::abs(last - first);
    voxel += first * stride[axis];
    per_step[axis] = 1 / std::fabs(way(axis));
    const int border = first + (way(axis) > 0 ? 1 : 0);
    next[axis] =
        left[axis] ? (border - from(axis)) / way(axis) : std::numeric_limits<double>::infinity();
    if (way(axis) < 0) stride[axis] = -stride[axis];
  }
  for (int steps = left[0] + left[1] + left[2];; --steps) {
    if (!visit(static_cast<std::size_t>(voxel)) || steps == 0) return;
    const int axis = next[0] < next[1] ? (next[0] < next[2] ? 0 : 2) : (next[1] < next[2] ? 1 : 2);
    voxel += stride[axis];
    next[axis] =
        --left[axis] ? next[axis] + per_step[axis] : std::numeric_limits<double>::infinity();
  }
}

}  // namespace docdepth
