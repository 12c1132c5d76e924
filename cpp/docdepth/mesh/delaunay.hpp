// Neighbours among the returns of a sweep: the Delaunay triangulation of their directions.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/mesh/directions.hpp"

namespace docdepth {

constexpr std::uint32_t kNone = 0xffffffff;  ///< no triangle

/// Half a cache line, so that none lies across two.
struct alignas(32) Triangle {
  /// Rows of returns, counterclockwise where azimuth is drawn to the right and elevation up.
  alignas(16) std::array<std::uint32_t, 3> corners;
  /// across[i] is the triangle beyond the edge from corner i to the next; kNone if there is none.
  alignas(16) std::array<std::uint32_t, 3> across;
};

/// Triangles that cover the field of view.
using Triangulation = std::vector<Triangle>;

/// Delaunay triangulation on the cylinder of azimuth and elevation, closed at +-180 degrees.
///
/// Four directions on one circle are split at the lowest row, so the result does not depend on the
/// order of work. Slivers along the border of the field of view are left out: a row of guard
/// vertices stands a degree or more outside of it.
///
/// @param directions  direction of every return
/// @param numbers     rows of the returns to triangulate; the first of equal directions is taken
Triangulation triangulate(const std::vector<Direction>& directions,
                          const std::vector<std::uint32_t>& numbers);

}  // namespace docdepth
