#include "docdepth/ground/ground.hpp"

#include <atomic>
#include <mutex>
#include <shared_mutex>
#include <vector>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/ground/front.hpp"
#include "docdepth/ground/octree.hpp"
#include "docdepth/ground/step_seeds.hpp"
#include "docdepth/ground/voxel_map.hpp"

namespace docdepth {
namespace {

using Eigen::Vector3d;

/// The search radius of seeds is not doubled beyond this [m], unless no point is nearer.
constexpr double kMaxSeedRadius = 16.0;
/// A LiDAR stands if all its poses lie within this [m]: its rings do not fill the ground.
constexpr double kStandingExtent = 2.0;

}  // namespace

struct GroundMap::State {
  GroundParameters parameters;
  int threads;
  std::optional<Vector3d> corner;
  Vector3d origin = Vector3d::Zero();  // also the corner of a voxel
  std::vector<Vector3d> positions;     // of the poses, relative to origin
  VoxelMap map;
  mutable std::shared_mutex mutex;  // several threads may call one map
  std::atomic<bool> stopped{false};

  VoxelGrid grid(const Pose& T_world_lidar) const {
    return VoxelGrid(T_world_lidar, origin, parameters.voxel_size);
  }
  /// Take the corner of a voxel at the first pose as origin: the map reaches far from there.
  void begin_at(const Vector3d& first) {
    if (!corner) corner = first;
    const Vector3d voxels = ((first - *corner) / parameters.voxel_size).array().round();
    origin = *corner + parameters.voxel_size * voxels;
  }
};

GroundMap::GroundMap(const GroundParameters& parameters, int threads,
                     std::optional<Vector3d> corner)
    : state_(new State) {
  state_->parameters = parameters;
  state_->threads = threads;
  state_->corner = corner;
}
GroundMap::~GroundMap() = default;

std::size_t GroundMap::size() const {
  const std::shared_lock<std::shared_mutex> lock(state_->mutex);
  return state_->map.size();
}

void GroundMap::insert(const Points& points, const Pose& T_world_lidar) {
  State& state = *state_;
  const std::unique_lock<std::shared_mutex> lock(state.mutex);
  if (state.positions.empty()) state.begin_at(T_world_lidar.translation());
  state.map.insert(points, state.grid(T_world_lidar), state.threads);
  state.positions.push_back(T_world_lidar.translation() - state.origin);
}

std::size_t GroundMap::grow() {
  State& state = *state_;
  const std::unique_lock<std::shared_mutex> lock(state.mutex);
  // A stop is meant for one call, also if it comes before that begins.
  struct Restart {
    std::atomic<bool>& stopped;
    ~Restart() { stopped = false; }
  } const restart{state.stopped};
  if (!state.map.size()) return 0;
  const Octree tree(state.map, state.threads);
  const auto points = static_cast<std::uint32_t>(tree.points().size());
  Eigen::AlignedBox3d extent;
  for (const Vector3d& position : state.positions) extent.extend(position);
  const bool stands = extent.diagonal().norm() < kStandingExtent;
  for (double first_radius = state.parameters.seed_radius;; first_radius *= 2.0) {
    Front front(tree, state.parameters, stands, state.threads, state.stopped);
    std::vector<std::uint32_t> seeds(state.positions.size());
    parallel_for(seeds.size(), 1, state.threads, [&](std::size_t i, std::size_t) {
      const Vector3d& position = state.positions[i];
      double radius = first_radius;
      while ((seeds[i] = tree.quantile(position.x(), position.y(), radius,
                                       state.parameters.seed_quantile)) == points)
        radius *= 2.0;
    });
    for (const std::uint32_t seed : seeds) front.seed(seed);
    front.grow();
    const auto ground = [&] {
      std::size_t count = 0;
      for (std::uint32_t i = 0; i < points; ++i) count += front.labelled(i);
      return count;
    };
    if (double(ground()) < state.parameters.least_share * points && first_radius < kMaxSeedRadius)
      continue;
    StepSeeds steps(tree, state.parameters, state.threads, state.origin - *state.corner,
                    stands ? std::optional<Vector3d>(extent.center()) : std::nullopt);
    while (state.parameters.step_height > 0 && steps.seed(front)) front.grow();
    tree.store_ground([&](std::uint32_t i) { return front.labelled(i); }, state.threads);
    return ground();
  }
}

void GroundMap::stop() {
  state_->stopped = true;
}

void GroundMap::label(const Points& points, const Pose& T_world_lidar, bool* ground) const {
  const std::shared_lock<std::shared_mutex> lock(state_->mutex);
  state_->map.label(points, state_->grid(T_world_lidar), state_->threads, ground);
}

}  // namespace docdepth
