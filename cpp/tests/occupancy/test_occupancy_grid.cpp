#include <doctest/doctest.h>

#include <algorithm>
#include <random>
#include <set>

#include "docdepth/occupancy/occupancy_grid.hpp"
#include "docdepth/occupancy/traversal.hpp"

using namespace docdepth;

namespace {

/// The length of a segment inside of a voxel, by clipping it at its six sides.
double length_inside(const Eigen::Vector3d& from, const Eigen::Vector3d& to,
                     const Eigen::Vector3d& low) {
  double begin = 0, end = 1;
  for (int axis = 0; axis < 3; ++axis) {
    const double a = (low(axis) - from(axis)) / (to - from)(axis);
    const double b = (low(axis) + 1 - from(axis)) / (to - from)(axis);
    begin = std::max(begin, std::min(a, b)), end = std::min(end, std::max(a, b));
  }
  return (end - begin) * (to - from).norm();
}

}  // namespace

TEST_CASE("a traversal visits the voxels in which a segment has a length, in order") {
  const std::array<int, 3> size{5, 4, 3};
  std::mt19937 random(1);
  std::uniform_real_distribution<double> any(-3, 8);
  for (int trial = 0; trial < 2000; ++trial) {
    const Eigen::Vector3d from(any(random), any(random), any(random));
    const Eigen::Vector3d to(any(random), any(random), any(random));
    std::vector<std::size_t> visited;
    traverse(from, to, size, [&](std::size_t voxel) {
      visited.push_back(voxel);
      return true;
    });
    const std::set<std::size_t> found(visited.begin(), visited.end());
    CHECK(found.size() == visited.size());
    double before = 0;
    std::size_t number = 0;
    for (int x = 0; x < size[0]; ++x)
      for (int y = 0; y < size[1]; ++y)
        for (int z = 0; z < size[2]; ++z, ++number) {
          const double length = length_inside(from, to, Eigen::Vector3d(x, y, z));
          if (std::abs(length) > 1e-9) CHECK(found.contains(number) == (length > 0));
        }
    for (const std::size_t voxel : visited) {
      const Eigen::Vector3d middle(double(voxel / 12) + 0.5, double(voxel / 3 % 4) + 0.5,
                                   double(voxel % 3) + 0.5);
      const double along = (middle - from).dot((to - from).cwiseSign());
      CHECK(along > before - 3);  // each step leads one voxel on, along some axis
      before = along;
    }
  }
}

TEST_CASE("axis-parallel segments, and one that stops") {
  std::vector<std::size_t> visited;
  const auto visit = [&](std::size_t voxel) {
    visited.push_back(voxel);
    return visited.size() < 2;
  };
  traverse({0.5, 0.5, 2.5}, {0.5, 0.5, -1}, {1, 1, 3}, visit);
  CHECK(visited == std::vector<std::size_t>{2, 1});
  visited.clear();
  traverse({1.5, 0.5, 2.5}, {1.5, 0.5, -1}, {1, 1, 3}, visit);  // beside the grid
  CHECK(visited.empty());
}

TEST_CASE("what stands is occupied by its share of rays, and free of none inside of a box") {
  OccupancyOptions options;
  options.voxel = 1, options.size = {10, 3, 1}, options.corner = {0, -1.5, 0};
  options.min_share = 0.1;
  const auto ray = [](float x, std::uint32_t count, std::uint16_t object) {
    return Ray{{-5, 0, 0.5}, {x, 0, 0.5}, 0, count, object, false};
  };
  OccupancyGrid grid(options);
  Pose T = Pose::Identity();
  T.translation() = Eigen::Vector3d(6, 0, 0);
  grid.add_object(3, T, {2, 1, 1});  // voxels 5 and 6 of the middle row
  // Of 101 rays one ends in voxel 2, of 100 twenty in voxel 4, the others beyond the grid.
  const std::vector<Ray> rays{ray(2.5, 1, 0), ray(4.5, 20, 0), ray(20, 80, 0)};
  grid.add_sweep(rays, Pose::Identity());
  const auto state = [&](int x) {
    const OccupiedVoxels found = grid.classify();
    const std::size_t voxel = std::size_t(x) * 3 + 1;
    return std::pair(found.occupied[voxel], bool(found.observed[voxel]));
  };
  CHECK(state(2) == std::pair(Occupied::kNot, true));
  CHECK(state(4) == std::pair(Occupied::kStatic, true));
  CHECK(state(5) == std::pair(Occupied::kNot, false));
  CHECK(state(7) == std::pair(Occupied::kNot, true));
  // With the object, half a metre behind where it is now, a ray passes its first half.
  T.translation() = Eigen::Vector3d(0.5, 0, 0);
  grid.add_sweep_of_object(3, 1, {ray(5.8f, 1, 1)}, T, {0, 0, 0});
  CHECK(state(5) == std::pair(Occupied::kNot, true));
  CHECK(state(6) == std::pair(Occupied::kObject, true));
  CHECK(grid.classify().object[6 * 3 + 1] == 3);
}
