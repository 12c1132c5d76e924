// Ground growing (paper III-C1): sweeps merged into voxels, seeds below the poses, a front that
// walks over flat neighbourhoods.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

struct GroundParameters {
  double voxel_size = 0.03;      ///< s, metres
  double seed_radius = 2.0;      ///< r_seed, metres
  double seed_quantile = 0.1;    ///< share of the points there that lie below the seed
  double least_share = 0.01;     ///< with less ground than this seeds are sought twice as far away
  int neighbors = 30;            ///< k_nn, the front point itself among them
  double plane_distance = 0.04;  ///< delta, metres
  double max_slope = 0.2617993877991494;  ///< alpha, radians
  double step_height = 0.25;  ///< ground goes on behind kerbs up to this high, metres; 0: not
};

/// The merged sweeps of one chunk and their ground.
///
/// Everything is a function of the inserted points and poses in their order: which voxels are
/// ground is what the front can reach, whatever way it takes, so threads change nothing.
class GroundMap {
 public:
  explicit GroundMap(const GroundParameters& parameters, int threads = 0);
  ~GroundMap();

  /// Merge one sweep. Coordinates are kept relative to the position of the first pose.
  /// @throws std::out_of_range a point is not finite or too far from the first pose.
  void insert(const Points& points, const Pose& T_world_lidar);

  /// Seed and grow over everything inserted so far. Near a pose there may be nothing but the ego's
  /// own body: while there is next to no ground, seeds are sought farther away. Then it goes on
  /// behind steps.
  /// @return number of ground voxels.
  std::size_t grow();

  /// For each point whether its voxel is ground; false where nothing was inserted.
  void label(const Points& points, const Pose& T_world_lidar, bool* ground) const;

  /// Number of voxels.
  std::size_t size() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace docdepth
