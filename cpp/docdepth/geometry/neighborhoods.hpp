// The nearest points of every point of a cloud.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// @param row      of a point
/// @param nearest  rows of the points nearest to it, the nearest first; of equals the first row.
/// The point itself is among them.
using UseNeighborhood =
    std::function<void(std::uint32_t row, const std::vector<std::uint32_t>& nearest)>;

/// Call `use` for each point of a cloud, from several threads and in no order.
/// @param points  finite, below 1e6 m
/// @param count   of nearest points; all if there are fewer
void for_each_neighborhood(const Points& points, int count, int threads,
                           const UseNeighborhood& use);

}  // namespace docdepth
