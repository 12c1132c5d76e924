// The rings of a sweep of a spinning LiDAR: neighbours without a search.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/mesh/directions.hpp"

namespace docdepth {

/// Returns of a sweep by ring. A ring is what one laser measured in one turn.
struct ScanRings {
  /// Rows of the sweep: one ring after the other from the lowest on, each by azimuth.
  std::vector<std::uint32_t> returns;
  /// Where each ring begins in `returns`, and the end. Empty if the sensor has no rings.
  std::vector<std::uint32_t> begin;

  std::size_t count() const { return begin.empty() ? 0 : begin.size() - 1; }
};

/// Find the rings from the order of the rows or from elevations.
///
/// Rows may come ring by ring; then a ring ends where the azimuth has made a turn, and motion of
/// the vehicle may have bent it. Rows in any other order, column by column or shuffled, belong to
/// rings if nearly all elevations lie at a few values, as those of points as measured do. Rosettes,
/// several LiDARs in one sweep, and bent rings out of order have none of the two.
///
/// @param directions  direction of every return
/// @param numbers     rows of the returns to use, ascending
ScanRings find_rings(const std::vector<Direction>& directions,
                     const std::vector<std::uint32_t>& numbers);

}  // namespace docdepth
