// Which returns of a sweep are neighbours: the Delaunay triangulation of their directions.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/surface/directions.hpp"

namespace docdepth {

constexpr std::uint32_t kNone = 0xffffffff;

/// Triangles that cover the directions in which a sensor saw something. Corners are numbers of
/// returns, counterclockwise as azimuth (right) and elevation (up) are drawn on paper;
/// `across[t][i]` is the triangle beyond the edge from corner i to the next one, kNone where there
/// is none.
struct Triangulation {
  std::vector<std::array<std::uint32_t, 3>> corners;
  std::vector<std::array<std::uint32_t, 3>> across;
};

/// Delaunay triangulation of directions on the cylinder of azimuth and elevation: it closes
/// at +-180 degrees. Four directions on one circle are split at the one with the lowest number, so
/// that the result is unique whatever the order of work. Slivers along the outer border of the
/// field of view are left out (the border is where a row of guards stands a degree or more
/// outside).
///
/// @param directions  of all returns
/// @param numbers     returns to take part; of several in one direction the first does
Triangulation triangulate(const std::vector<Direction>& directions,
                          const std::vector<std::uint32_t>& numbers);

}  // namespace docdepth
