#include "docdepth/ground/ground.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <condition_variable>
#include <limits>
#include <map>
#include <mutex>
#include <shared_mutex>
#include <stdexcept>
#include <vector>

#include "docdepth/geometry/normal.hpp"
#include "docdepth/geometry/parallel.hpp"
#include "docdepth/ground/neighborhood.hpp"
#include "docdepth/ground/octree.hpp"
#include "docdepth/ground/voxel_map.hpp"

namespace docdepth {
namespace {

using Eigen::Vector3d;

/// The search radius of seeds is not doubled beyond this [m], unless no point is nearer.
constexpr double kMaxSeedRadius = 16.0;
/// Behind a step, ground is sought in cells of this edge on the plan [m].
constexpr double kStepCell = 1.0;
/// A thread takes at most so many leaves of the front at once.
constexpr std::size_t kLeavesAtOnce = 8;
/// Reach of the first search for neighbours, in distances expected for evenly spread points.
constexpr double kFirstReach = 0.7;
/// After a search that was too short, reach farther than needed by this factor, for other points.
constexpr double kReachMargin = 1.2;
/// Where the nearest points lie on a line, so many times as many tell the plane.
constexpr std::size_t kWider = 8;
/// A LiDAR stands if all its poses lie within this [m]: its rings do not fill the ground.
constexpr double kStandingExtent = 2.0;

/// The front: the points that it has reached, which of them have passed it on, and the leaves that
/// hold the others. What it reaches in the end does not depend on the order, so threads take leaves
/// freely.
class Front {
 public:
  /// @param stands  whether the LiDAR stands
  Front(const Octree& tree, const GroundParameters& parameters, bool stands, int threads,
        const std::atomic<bool>& stopped)
      : tree_(tree),
        parameters_(parameters),
        stands_(stands),
        stopped_(stopped),
        threads_(thread_count(threads)),
        cos_max_slope_(std::cos(parameters.max_slope)),
        labels_(tree.points().size()),
        widened_(tree.points().size()),
        queued_(tree.nodes().size()),
        reach_(tree.nodes().size(), 0.f) {}

  void seed(std::uint32_t point) {
    std::uint8_t none = kNone;
    if (!labels_[point].compare_exchange_strong(none, kReached)) return;
    seeds_.insert(std::upper_bound(seeds_.begin(), seeds_.end(), point), point);
    queue(tree_.leaf_of(point), next_);
  }
  void grow() {
    do spread();
    while (stands_ && widen());
  }
  bool labelled(std::uint32_t point) const {
    return labels_[point].load(std::memory_order_relaxed) != kNone;
  }

 private:
  enum Label : std::uint8_t { kNone, kReached, kDone };
  using Leaves = std::vector<std::uint32_t>;

  void queue(std::uint32_t leaf, Leaves& leaves) {
    if (!queued_[leaf].exchange(1)) leaves.push_back(leaf);
  }
  void spread();
  bool widen();
  Neighborhood::Outcome search(std::uint32_t point, std::uint32_t leaf, Neighborhood& hood,
                               bool always) const;
  bool is_line(Neighborhood& hood) const;
  double first_reach(std::uint32_t leaf) const;
  void visit(std::uint32_t leaf, Neighborhood& hood, Leaves& reached);
  void pass_on(std::uint32_t point, std::uint32_t leaf, Neighborhood& hood,
               std::vector<std::uint32_t>& pending, Leaves& reached);

  const Octree& tree_;
  const GroundParameters& parameters_;
  bool stands_;
  const std::atomic<bool>& stopped_;
  int threads_;
  double cos_max_slope_;
  std::vector<std::atomic<std::uint8_t>> labels_;
  std::vector<std::uint8_t> widened_;  // points of which it is known whether more tell the plane
  std::vector<std::atomic<std::uint8_t>> queued_;  // leaves that wait for a thread
  std::vector<float> reach_;                       // reach that the last visit of a leaf needed
  std::vector<std::uint32_t> seeds_;               // ascending
  Leaves next_;
};

/// Threads take leaves from a common list until it is empty and no thread works any more.
void Front::spread() {
  std::mutex mutex;
  std::condition_variable changed;
  std::size_t first = 0, working = 0;  // first leaf that is not taken; busy threads
  const auto work = [&](std::size_t, std::size_t) {
    const auto k = std::min<std::size_t>(parameters_.neighbors, labels_.size());
    Neighborhood hood(tree_, labels_, k);
    Leaves taken, reached;
    std::unique_lock<std::mutex> lock(mutex);
    for (;;) {
      changed.wait(lock, [&] { return first < next_.size() || !working; });
      if (first == next_.size()) break;
      const std::size_t fair = (next_.size() - first) / (2 * threads_) + 1;
      taken.assign(next_.begin() + first, next_.begin() + first + std::min(kLeavesAtOnce, fair));
      first += taken.size();
      ++working;
      lock.unlock();
      reached.clear();
      try {
        if (stopped_) throw std::runtime_error("the growth of the ground was stopped");
        for (const std::uint32_t leaf : taken) visit(leaf, hood, reached);
      } catch (...) {
        lock.lock();
        --working;  // else the others would wait for this one
        changed.notify_all();
        throw;
      }
      lock.lock();
      --working;
      next_.insert(next_.end(), reached.begin(), reached.end());
      changed.notify_all();
    }
  };
  parallel_for(threads_, 1, threads_, work);
  next_.clear();
}

/// Pass the front on where it has come to rest, through points whose nearest ones lie on a steep
/// line: they are of one ring, and their noise along the rays tells nothing of the surface. More
/// points do.
/// @return whether it has reached others
bool Front::widen() {
  const auto& nodes = tree_.nodes();
  const auto k = std::min<std::size_t>(parameters_.neighbors, labels_.size());
  constexpr auto none = std::numeric_limits<std::uint32_t>::max();  // all leaves are others
  std::mutex mutex;
  parallel_for(nodes.size(), 16, threads_, [&](std::size_t begin, std::size_t end) {
    Neighborhood hood(tree_, labels_, k),
        wide(tree_, labels_, std::min(kWider * k, labels_.size()));
    Leaves reached;
    std::vector<std::uint32_t> pending;
    for (auto leaf = static_cast<std::uint32_t>(begin); leaf < end; ++leaf) {
      if (nodes[leaf].children) continue;
      std::vector<std::uint32_t> points;
      for (std::uint32_t i = nodes[leaf].begin; i < nodes[leaf].end; ++i)
        if (!widened_[i] && labels_[i].load() == kDone) points.push_back(i);
      if (points.empty()) continue;
      hood.gather(leaf, first_reach(leaf));
      bool is_gathered = false;
      for (const std::uint32_t point : points) {
        widened_[point] = 1;
        search(point, leaf, hood, true);
        if (!is_line(hood)) continue;
        if (!is_gathered) wide.gather(leaf, 2 * hood.reach());
        is_gathered = true;
        if (search(point, leaf, wide, false) == Neighborhood::Outcome::kFound)
          pass_on(point, none, wide, pending, reached);
      }
    }
    const std::lock_guard<std::mutex> lock(mutex);
    next_.insert(next_.end(), reached.begin(), reached.end());
  });
  return !next_.empty();
}

/// The neighbours of a point; more points are gathered until enough are within reach.
Neighborhood::Outcome Front::search(std::uint32_t point, std::uint32_t leaf, Neighborhood& hood,
                                    bool always) const {
  for (;;) {
    const auto outcome = hood.search(point, always);
    if (outcome != Neighborhood::Outcome::kReachTooShort) return outcome;
    hood.gather(leaf, kReachMargin * std::max(hood.needed_reach(), parameters_.voxel_size));
  }
}

/// Whether the neighbours that were found lie on a line, as far as their noise tells, and the plane
/// through them is too steep for the front.
bool Front::is_line(Neighborhood& hood) const {
  const Eigen::Matrix3d spread = hood.covariance(hood.mean());
  if (std::abs(smallest_eigenvector(spread).z()) >= cos_max_slope_) return false;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(spread, Eigen::EigenvaluesOnly);
  const double width = parameters_.plane_distance;
  return axes.eigenvalues()[1] <= double(hood.nearest().size()) * width * width;
}

/// Expected distance to the k-th neighbour, as if the points covered the box of the leaf evenly.
double Front::first_reach(std::uint32_t leaf) const {
  if (reach_[leaf] > 0.f) return reach_[leaf];
  const auto& node = tree_.nodes()[leaf];
  const double points = node.end - node.begin, side = node.box.sizes().maxCoeff();
  const double reach = kFirstReach * std::max(side, parameters_.voxel_size) *
                       std::sqrt(parameters_.neighbors / points);
  return std::max(reach, parameters_.voxel_size);
}

/// Let every point of the leaf that the front has reached pass it on.
void Front::visit(std::uint32_t leaf, Neighborhood& hood, Leaves& reached) {
  queued_[leaf].store(0);
  const auto& node = tree_.nodes()[leaf];
  std::vector<std::uint32_t> pending;
  for (std::uint32_t i = node.begin; i < node.end; ++i)
    if (labels_[i].load() == kReached) pending.push_back(i);
  if (pending.empty()) return;
  hood.gather(leaf, first_reach(leaf));
  while (!pending.empty()) {
    const std::uint32_t point = pending.back();
    const auto outcome = search(point, leaf, hood, false);
    pending.pop_back();
    labels_[point].store(kDone);
    if (outcome == Neighborhood::Outcome::kFound) pass_on(point, leaf, hood, pending, reached);
  }
  reach_[leaf] = static_cast<float>(hood.reach());
}

/// Label the neighbours on the plane of a front point, unless that is too steep. The plane of a
/// seed passes through the mean of the neighbours instead of the seed: the lowest point near a pose
/// is often a ghost return below the road, with no neighbour at its height.
void Front::pass_on(std::uint32_t point, std::uint32_t leaf, Neighborhood& hood,
                    std::vector<std::uint32_t>& pending, Leaves& reached) {
  const auto& nearest = hood.nearest();
  if (nearest.size() < 3) return;
  const Vector3d mean = hood.mean();
  const Vector3d normal = smallest_eigenvector(hood.covariance(mean));
  if (!(std::abs(normal.z()) >= cos_max_slope_)) return;
  const bool is_seed = std::binary_search(seeds_.begin(), seeds_.end(), point);
  const Vector3d on_plane = is_seed ? mean : Vector3d::Zero();

  for (std::size_t n = 0; n < nearest.size(); ++n) {
    const std::uint32_t c = nearest[n];
    if (!hood.open(c)) continue;
    if (!(std::abs(normal.dot(hood.offset(n) - on_plane)) < parameters_.plane_distance)) continue;
    hood.close(c);
    std::uint8_t none = kNone;
    if (!labels_[hood.index(c)].compare_exchange_strong(none, kReached)) continue;
    const std::uint32_t home = hood.leaf(c);
    if (home == leaf)
      pending.push_back(hood.index(c));
    else
      queue(home, reached);
  }
}

/// Continues the ground behind steps, which the front cannot climb, and behind the gaps of sparse
/// rings. If a cell of the plan has ground, half as many points as tell a plane, and its neighbour
/// not as many as these, the low point of the neighbour becomes a seed, provided that it is higher
/// or lower by at most a step.
class Plan {
 public:
  /// @param offset  from a corner of a cell to the origin of the points
  Plan(const Octree& tree, const GroundParameters& parameters, int threads, const Vector3d& offset)
      : tree_(tree),
        parameters_(parameters),
        threads_(threads),
        offset_(offset),
        counted_(tree.points().size()) {}

  /// @return whether there are new seeds
  bool seed(Front& front) {
    count(front);
    using Low = Lows::value_type;
    std::vector<std::pair<double, Low*>> steps;  // height of the ground before each
    std::vector<Low*> unsearched;
    for (const auto& [cell, ground] : cells_) {
      if (2 * ground.points < std::size_t(parameters_.neighbors)) continue;
      for (int n = 0; n < 9; ++n) {
        const Cell neighbor{cell[0] + n / 3 - 1, cell[1] + n % 3 - 1};
        if (is_full(neighbor)) continue;
        const auto [low, is_new] = lows_.try_emplace(neighbor);
        if (is_new) unsearched.push_back(&*low);
        steps.emplace_back(ground.heights / double(ground.points), &*low);
      }
    }
    parallel_for(unsearched.size(), 16, threads_, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i)
        unsearched[i]->second = low_point(unsearched[i]->first);
    });
    bool any = false;
    for (const auto& [height, place] : steps) {
      const std::uint32_t low = place->second;
      if (low == tree_.points().size() || front.labelled(low)) continue;
      if (std::abs(tree_.points()[low].z() - height) > parameters_.step_height) continue;
      front.seed(low);
      any = true;
    }
    return any;
  }

 private:
  using Cell = std::array<std::int64_t, 2>;
  using Lows = std::map<Cell, std::uint32_t>;
  struct Ground {
    std::size_t points = 0;
    double heights = 0;  ///< their sum
  };

  bool is_full(const Cell& cell) const {
    const auto found = cells_.find(cell);
    return found != cells_.end() && found->second.points >= std::size_t(parameters_.neighbors);
  }
  /// Count the points that the front has reached since.
  void count(const Front& front) {
    Ground* ground = nullptr;
    Cell last{};
    for (std::uint32_t i = 0; i < counted_.size(); ++i) {
      if (counted_[i] || !front.labelled(i)) continue;
      counted_[i] = 1;
      const Vector3d p = tree_.points()[i] + offset_;
      const Cell cell{std::int64_t(std::floor(p.x() / kStepCell)),
                      std::int64_t(std::floor(p.y() / kStepCell))};
      if (!ground || cell != last) ground = &cells_[cell];  // points are sorted along a curve
      last = cell;
      ++ground->points;
      ground->heights += tree_.points()[i].z();
    }
  }
  std::uint32_t low_point(const Cell& cell) const {
    const double x = (double(cell[0]) + 0.5) * kStepCell, y = (double(cell[1]) + 0.5) * kStepCell;
    return tree_.quantile(x - offset_.x(), y - offset_.y(), 0.5 * kStepCell,
                          parameters_.seed_quantile);
  }

  const Octree& tree_;
  const GroundParameters& parameters_;
  int threads_;
  Vector3d offset_;
  std::vector<std::uint8_t> counted_;
  std::map<Cell, Ground> cells_;
  Lows lows_;  ///< low point of each cell searched so far
};

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
    Plan plan(tree, state.parameters, state.threads, state.origin - *state.corner);
    while (state.parameters.step_height > 0 && plan.seed(front)) front.grow();
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
