// Exact nearest neighbours between two clouds, by a k-d tree (nanoflann).
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

struct NearestNeighbors {
  std::vector<std::uint32_t> index;  ///< row of the nearest point of each query
  std::vector<float> distance;       ///< to it [m]
};

/// The nearest point of each query; of equally near ones the first. The tree reads the points where
/// they are, and the result does not depend on the number of threads.
/// @throws std::invalid_argument a point or query is not finite or beyond 1e18 m, or there
///   are queries but no points
NearestNeighbors nearest_neighbors(const Points& points, const Points& queries, int threads);

}  // namespace docdepth
