#include <doctest/doctest.h>

#include <cmath>
#include <random>
#include <stdexcept>

#include "docdepth/geometry/nearest_neighbors.hpp"

using namespace docdepth;

namespace {

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

}  // namespace

TEST_CASE("nearest neighbours are those of a plain search, of equals the first") {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> any(-50, 50);
  for (const float grid : {0.0f, 5.0f}) {  // on the grid there are duplicates and ties
    const auto cloud = [&](int count) {
      Matrix points(count, 3);
      for (int i = 0; i < count; ++i)
        for (int axis = 0; axis < 3; ++axis) {
          const float value = any(random);
          points(i, axis) = grid > 0 ? grid * std::round(value / grid) : value;
        }
      return points;
    };
    const Matrix points = cloud(3000), queries = cloud(2500);
    const NearestNeighbors one = nearest_neighbors(points, queries, 1);
    const NearestNeighbors two = nearest_neighbors(points, queries, 2);
    CHECK(one.index == two.index);
    CHECK(one.distance == two.distance);
    for (int i = 0; i < queries.rows(); ++i) {
      std::uint32_t nearest = 0;
      float least = INFINITY;
      for (int j = 0; j < points.rows(); ++j) {
        const float x = queries(i, 0) - points(j, 0), y = queries(i, 1) - points(j, 1),
                    z = queries(i, 2) - points(j, 2), squared = (x * x + y * y) + z * z;
        if (squared < least) {
          least = squared;
          nearest = static_cast<std::uint32_t>(j);
        }
      }
      REQUIRE(one.index[i] == nearest);
      REQUIRE(one.distance[i] == std::sqrt(least));
    }
  }
}

TEST_CASE("nearest neighbours need finite points") {
  Matrix points = Matrix::Ones(4, 3), none(0, 3);
  CHECK(nearest_neighbors(points, none, 1).index.empty());
  CHECK(nearest_neighbors(none, none, 1).index.empty());
  CHECK_THROWS_AS(nearest_neighbors(none, points, 1), std::invalid_argument);
  Matrix broken = points;
  broken(2, 1) = NAN;
  CHECK_THROWS_AS(nearest_neighbors(broken, points, 1), std::invalid_argument);
  CHECK_THROWS_AS(nearest_neighbors(points, broken, 1), std::invalid_argument);
}
