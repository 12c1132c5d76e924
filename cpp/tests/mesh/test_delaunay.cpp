#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <set>
#include <utility>
#include <vector>

#include "docdepth/mesh/delaunay.hpp"
#include "docdepth/mesh/scan_rings.hpp"

using namespace docdepth;

namespace {

using Directions = std::vector<Direction>;
__extension__ typedef __int128 Wide;

/// How far d lies inside the circle through a, b and c, which turn counterclockwise; times a
/// positive number. The determinant of every textbook.
Wide depth_in_circle(const Direction& a, const Direction& b, const Direction& c,
                     const Direction& d) {
  Wide rows[3][3];
  const Direction* corners[] = {&a, &b, &c};
  for (int k = 0; k < 3; ++k) {
    const Wide x = std::int16_t(corners[k]->azimuth - d.azimuth);  // by the shorter way
    const Wide y = corners[k]->elevation - d.elevation;
    rows[k][0] = x;
    rows[k][1] = y;
    rows[k][2] = x * x + y * y;
  }
  const auto minor = [&](int i, int j) {
    return rows[i][0] * rows[j][1] - rows[i][1] * rows[j][0];
  };
  return rows[0][2] * minor(1, 2) - rows[1][2] * minor(0, 2) + rows[2][2] * minor(0, 1);
}

std::int64_t area(const Direction& a, const Direction& b, const Direction& c) {
  const std::int64_t bx = std::int16_t(b.azimuth - a.azimuth), by = b.elevation - a.elevation;
  const std::int64_t cx = std::int16_t(c.azimuth - a.azimuth), cy = c.elevation - a.elevation;
  return bx * cy - by * cx;
}

std::vector<std::uint32_t> rows_of(const Directions& directions) {
  std::vector<std::uint32_t> rows(directions.size());
  std::iota(rows.begin(), rows.end(), 0);
  return rows;
}

/// Every triangle is beside its neighbours, every edge is Delaunay, and of equal directions the
/// first has its triangles.
void check(const Directions& directions, const Triangulation& triangles) {
  int wrong_neighbours = 0, wrong_edges = 0, turned = 0;
  std::vector<std::uint8_t> used(directions.size(), 0);
  for (std::uint32_t t = 0; t < triangles.size(); ++t)
    for (int i = 0; i < 3; ++i) {
      const auto &corners = triangles[t].corners, &across = triangles[t].across;
      const auto a = corners[i], b = corners[(i + 1) % 3], c = corners[(i + 2) % 3];
      used[a] = 1;
      turned += area(directions[a], directions[b], directions[c]) <= 0;
      if (across[i] == kNone) continue;
      const auto& other = triangles[across[i]];
      int j = 0;
      while (j < 3 && other.corners[j] != b) ++j;
      if (j == 3 || other.corners[(j + 1) % 3] != a || other.across[j] != t) {
        ++wrong_neighbours;
        continue;
      }
      const auto d = other.corners[(j + 2) % 3];
      const Wide depth =
          depth_in_circle(directions[a], directions[b], directions[c], directions[d]);
      wrong_edges += depth > 0 || (depth == 0 && std::min(c, d) < std::min(a, b));
    }
  CHECK(wrong_neighbours == 0);
  CHECK(wrong_edges == 0);
  CHECK(turned == 0);
  std::set<std::pair<std::int32_t, std::int32_t>> seen;
  int missing = 0;
  for (std::size_t k = 0; k < directions.size(); ++k)
    missing += used[k] != seen.emplace(directions[k].azimuth, directions[k].elevation).second;
  CHECK(missing == 0);
}

/// Rings of two blocks of lasers, 15 cm above each other, that see near things before far ones from
/// a vehicle that drives: rings are bent and cross. Rows ring by ring.
Directions crossing_rings(std::mt19937& random) {
  Directions directions;
  for (int k = 0; k < 40; ++k)
    for (int c = 0; c < 600; ++c) {
      if (random() % 20 == 0) continue;
      const double share = (c + 0.5) / 600, azimuth = M_PI - 2 * M_PI * share;
      const double elevation = (8 - k) * M_PI / 360, range = c / 8 % 6 == 0 ? 5 : 20;
      directions.push_back(direction_of(float(range * std::cos(azimuth) + 1.5 * (share - 0.5)),
                                        float(range * std::sin(azimuth)),
                                        float(range * std::tan(elevation) + (k < 20 ? 0.15 : 0))));
    }
  return directions;
}

}  // namespace

TEST_CASE("crossing rings and the same returns in any order have the same Delaunay triangles") {
  std::mt19937 random(7);
  Directions directions = crossing_rings(random);
  REQUIRE(find_rings(directions, rows_of(directions)).count() > 30);
  const Triangulation ring_by_ring = triangulate(directions, rows_of(directions));
  check(directions, ring_by_ring);
  std::shuffle(directions.begin(), directions.end(), random);
  REQUIRE(find_rings(directions, rows_of(directions)).count() == 0);
  const Triangulation shuffled = triangulate(directions, rows_of(directions));
  check(directions, shuffled);
  CHECK(ring_by_ring.size() == shuffled.size());
}

TEST_CASE("of equal directions of two rings the first has the triangles") {
  std::mt19937 random(8);
  Directions directions = crossing_rings(random);
  // Every 50th return of a ring gets the direction of one of the next ring.
  for (std::size_t k = 0; k + 580 < directions.size(); k += 50) directions[k] = directions[k + 570];
  REQUIRE(find_rings(directions, rows_of(directions)).count() > 30);
  check(directions, triangulate(directions, rows_of(directions)));
}

TEST_CASE("a regular grid has one triangulation, whatever finds its rings") {
  Directions by_ring, by_column;
  for (int k = 0; k < 16; ++k)
    for (int c = 0; c < 512; ++c) by_ring.push_back({c * 128 - kTurn / 2, k * 200 - 1500});
  for (int c = 0; c < 512; ++c)
    for (int k = 0; k < 16; ++k) by_column.push_back({c * 128 - kTurn / 2, k * 200 - 1500});
  for (const auto& directions : {by_ring, by_column}) {
    CHECK(find_rings(directions, rows_of(directions)).count() == 16);
    const Triangulation triangles = triangulate(directions, rows_of(directions));
    CHECK(triangles.size() == 2 * 15 * 512);
    check(directions, triangles);
  }
}
