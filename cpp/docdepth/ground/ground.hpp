// Ground growing (paper IV-A): sweeps are merged into voxels, seeds lie below the poses, and a
// front grows over flat neighbourhoods.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

struct GroundParameters {
  double voxel_size = 0.03;  ///< s of the paper [m]
  double seed_radius = 2.0;  ///< r_seed: seeds lie within this distance of a pose [m]
  double seed_quantile =
      0.1;  ///< share of the points within seed_radius that are lower than the seed
  double least_share = 0.01;     ///< with a smaller share of ground, seed_radius is doubled
  int neighbors = 30;            ///< k_nn, including the point itself
  double plane_distance = 0.04;  ///< delta: ground lies within this distance of the plane [m]
  double max_slope = 0.2617993877991494;  ///< alpha [rad]: 15 degrees
  double step_height = 0.25;  ///< ground continues behind steps up to this height [m]; 0: never
};

/// The merged sweeps of a chunk and their ground.
///
/// The ground is everything that the front can reach, in any order of work, so the result does not
/// depend on the number of threads.
class GroundMap {
 public:
  /// @param corner  of some voxel, in the world: maps with the same one have the same voxels where
  ///                they overlap. The position of the first pose by default.
  explicit GroundMap(const GroundParameters& parameters, int threads = 0,
                     std::optional<Eigen::Vector3d> corner = std::nullopt);
  ~GroundMap();

  /// Merge a sweep. Coordinates are kept relative to the corner of a voxel at the first pose.
  /// @throws std::out_of_range a point is not finite or too far from the first pose
  void insert(const Points& points, const Pose& T_world_lidar);

  /// Grow ground over all sweeps inserted so far, then behind steps. Near a pose there may be only
  /// the ego vehicle: as long as there is hardly any ground, seeds are searched farther away.
  /// @return number of ground voxels
  /// @throws std::runtime_error stop() was called; the map is as before
  std::size_t grow();

  /// End grow() in another thread soon. A large chunk grows for many seconds.
  void stop();

  /// Whether the voxel of each point is ground; false where nothing was inserted.
  void label(const Points& points, const Pose& T_world_lidar, bool* ground) const;

  /// Number of voxels.
  std::size_t size() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace docdepth
