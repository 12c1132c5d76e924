#include <doctest/doctest.h>

#include <algorithm>
#include <numeric>
#include <random>
#include <vector>

#include "docdepth/geometry/neighborhoods.hpp"

using namespace docdepth;

namespace {

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;
using NearestRows = std::vector<std::uint32_t>;

/// Points of a lattice: many are equal, and many are as far from a point as others.
Matrix grid_points(int count, int edge) {
  std::mt19937 random(5);
  std::uniform_int_distribution<int> any(0, edge);
  Matrix points(count, 3);
  for (int i = 0; i < count; ++i)
    for (int axis = 0; axis < 3; ++axis) points(i, axis) = 0.5f * float(any(random)) - 700;
  return points;
}

/// The neighbourhood of a point by a look at all others.
NearestRows plain_nearest(const Matrix& points, Eigen::Index of, std::size_t count) {
  NearestRows rows(static_cast<std::size_t>(points.rows()));
  std::iota(rows.begin(), rows.end(), 0);
  std::stable_sort(rows.begin(), rows.end(), [&](std::uint32_t a, std::uint32_t b) {
    return (points.row(a) - points.row(of)).squaredNorm() <
           (points.row(b) - points.row(of)).squaredNorm();
  });
  rows.resize(std::min(count, rows.size()));
  return rows;
}

std::vector<NearestRows> found_nearest(const Matrix& points, int count, int threads) {
  std::vector<NearestRows> all(static_cast<std::size_t>(points.rows()));
  for_each_neighborhood(points, count, threads,
                        [&](std::uint32_t row, const NearestRows& nearest) { all[row] = nearest; });
  return all;
}

}  // namespace

TEST_CASE("neighbourhoods hold the nearest points, and of equals the first") {
  for (const int points_in_all : {1, 7, 8, 9, 100, 700}) {
    const Matrix points = grid_points(points_in_all, points_in_all < 100 ? 3 : 30);
    for (const int count : {1, 5, 20}) {
      const std::vector<NearestRows> one = found_nearest(points, count, 1);
      for (Eigen::Index i = 0; i < points.rows(); ++i)
        CHECK(one[std::size_t(i)] == plain_nearest(points, i, std::size_t(count)));
      CHECK(found_nearest(points, count, 4) == one);
    }
  }
  CHECK(found_nearest(grid_points(0, 3), 5, 1).empty());
}
