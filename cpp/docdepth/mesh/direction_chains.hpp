// The directions of a sweep in chains, one above the other: rings where there are rings.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/mesh/directions.hpp"

namespace docdepth {

/// A direction on the cylinder of azimuth x and elevation y, unrolled onto a plane.
struct Vertex {
  std::int32_t x, y;
  std::uint32_t number;  ///< row of the return; guards continue the numbering
};

inline bool before(const Vertex& a, const Vertex& b) {
  return a.x != b.x ? a.x < b.x : a.y < b.y;
}

/// Chains from the lowest to the highest. Each begins and ends with a guard beyond all returns,
/// the first and the last are of guards alone. Chains of bent rings may cross, and the same
/// direction may come in two chains.
struct Chains {
  std::vector<Vertex> vertices;      ///< chain after chain; each ascending, without equal ones
  std::vector<std::uint32_t> begin;  ///< of each chain, and the end
};

/// Cut the directions of returns into chains.
///
/// Returns near the seam behind the sensor come twice, once beyond either end.
///
/// @param directions  direction of every return
/// @param numbers     rows of the returns to use, ascending; of equal directions the first is taken
Chains make_chains(const std::vector<Direction>& directions,
                   const std::vector<std::uint32_t>& numbers);

}  // namespace docdepth
