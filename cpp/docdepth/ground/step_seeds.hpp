// Ground behind steps, which the front cannot climb.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "docdepth/ground/front.hpp"

namespace docdepth {

/// Continues the ground behind steps, which the front cannot climb, and behind the gaps of sparse
/// rings. If a cell of the plan has ground, half as many points as tell a plane, and its neighbour
/// not as many as these, the low point of the neighbour becomes a seed, provided that it is higher
/// or lower by at most a step. Around a LiDAR that stands, several metres may be empty between two
/// rings: there the neighbour is the next cell with points, away from the LiDAR.
class StepSeeds {
 public:
  /// @param offset  from a corner of a cell to the origin of the points
  /// @param lidar   where it stands, from the origin of the points; none if it drives
  StepSeeds(const Octree& tree, const GroundParameters& parameters, int threads,
            const Eigen::Vector3d& offset, const std::optional<Eigen::Vector3d>& lidar)
      : tree_(tree),
        parameters_(parameters),
        threads_(threads),
        offset_(offset),
        lidar_(lidar),
        counted_(tree.points().size()) {}

  /// @return whether there are new seeds
  bool seed(Front& front);

 private:
  using Cell = std::array<std::int64_t, 2>;
  using Lows = std::map<Cell, std::uint32_t>;
  struct Ground {
    std::size_t points = 0;
    double heights = 0;  ///< their sum

    double height() const { return heights / double(points); }
  };

  bool seed_steps(Front& front);
  bool seed_beyond_gaps(Front& front);

  /// Whether the ground of a cell tells a plane, or half of one.
  bool is_full(const Cell& cell) const;
  bool is_half_full(const Ground& ground) const {
    return 2 * ground.points >= std::size_t(parameters_.neighbors);
  }
  /// Count the points that the front has reached since.
  void count(const Front& front);
  std::uint32_t low_point(const Cell& cell) const;

  const Octree& tree_;
  const GroundParameters& parameters_;
  int threads_;
  Eigen::Vector3d offset_;
  std::optional<Eigen::Vector3d> lidar_;
  std::vector<std::uint8_t> counted_;
  std::map<Cell, Ground> cells_;
  Lows lows_;  ///< low point of each cell searched so far
};

}  // namespace docdepth
