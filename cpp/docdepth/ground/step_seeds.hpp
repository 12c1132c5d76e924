// Ground behind steps, which the front cannot climb.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <vector>

#include "docdepth/ground/front.hpp"

namespace docdepth {

/// Continues the ground behind steps, which the front cannot climb, and behind the gaps of sparse
/// rings. If a cell of the plan has ground, half as many points as tell a plane, and its neighbour
/// not as many as these, the low point of the neighbour becomes a seed, provided that it is higher
/// or lower by at most a step.
class StepSeeds {
 public:
  /// @param offset  from a corner of a cell to the origin of the points
  StepSeeds(const Octree& tree, const GroundParameters& parameters, int threads,
            const Eigen::Vector3d& offset)
      : tree_(tree),
        parameters_(parameters),
        threads_(threads),
        offset_(offset),
        counted_(tree.points().size()) {}

  /// @return whether there are new seeds
  bool seed(Front& front);

 private:
  using Cell = std::array<std::int64_t, 2>;
  using Lows = std::map<Cell, std::uint32_t>;
  struct Ground {
    std::size_t points = 0;
    double heights = 0;  ///< their sum
  };

  /// Whether the ground of a cell tells a plane.
  bool is_full(const Cell& cell) const;
  /// Count the points that the front has reached since.
  void count(const Front& front);
  std::uint32_t low_point(const Cell& cell) const;

  const Octree& tree_;
  const GroundParameters& parameters_;
  int threads_;
  Eigen::Vector3d offset_;
  std::vector<std::uint8_t> counted_;
  std::map<Cell, Ground> cells_;
  Lows lows_;  ///< low point of each cell searched so far
};

}  // namespace docdepth
