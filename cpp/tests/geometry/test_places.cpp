#include <doctest/doctest.h>

#include <cmath>
#include <random>
#include <vector>

#include "docdepth/geometry/box_tree.hpp"
#include "docdepth/geometry/point_grid.hpp"

using namespace docdepth;

namespace {

/// Points on a lattice, so that many are equally near, some of them twice.
SampledPoints lattice(std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  SampledPoints points;
  for (std::size_t i = 0; i < count; ++i)
    points.push_back(0.25f * Eigen::Vector3f(float(random() % 40) - 13, float(random() % 9),
                                             float(random() % 6)));
  return points;
}

}  // namespace

TEST_CASE("the grid finds the point that a look at all points finds") {
  const SampledPoints points = lattice(300, 1), queries = lattice(200, 2);
  const PointGrid grid(points);
  int near = 0;
  for (const Eigen::Vector3f& p : queries)
    for (const float distance : {0.25f, 0.3f, 0.6f}) {
      std::pair<float, std::size_t> best{INFINITY, 0};
      for (std::size_t i = 0; i < points.size(); ++i)
        best = std::min(best, {(points[i] - p).squaredNorm(), i});
      if (best.first > distance * distance) {
        CHECK(grid.nearest(p, distance).first > distance * distance);
      } else {
        CHECK(grid.nearest(p, distance) == best);
        ++near;
      }
    }
  CHECK(near > 100);
}

TEST_CASE("a grid of no points and a place far from all find nothing") {
  CHECK(std::isinf(PointGrid({}).nearest({0, 0, 0}, 1).first));
  CHECK(std::isinf(PointGrid({{0, 0, 0}}).nearest({1e6f, 0, 0}, 1).first));
  CHECK(std::isinf(PointGrid({{0, 0, 0}, {1e6f, 1e6f, 0}}).nearest({5e5f, 5e5f, 0}, 1).first));
}

TEST_CASE("the tree finds the boxes that a look at all boxes finds") {
  std::vector<Extent> boxes;
  const SampledPoints corners = lattice(500, 3), sizes = lattice(500, 4);
  for (std::size_t k = 0; k < corners.size(); ++k)
    boxes.push_back({corners[k], corners[k] + sizes[k].cwiseAbs() * (k % 50 ? 0.1f : 5.0f)});
  const BoxTree tree(boxes);
  for (const float margin : {0.0f, 0.25f, 2.0f})
    for (std::size_t k = 0; k < boxes.size(); k += 7) {
      std::vector<std::uint32_t> all;
      for (std::uint32_t other = 0; other < boxes.size(); ++other)
        if (boxes[other].overlaps(boxes[k], margin)) all.push_back(other);
      CHECK(tree.near(boxes[k], margin) == all);
    }
  CHECK(BoxTree(std::vector<Extent>{}).near(boxes[0], 1).empty());
}
