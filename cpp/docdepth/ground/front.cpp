#include "docdepth/ground/front.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <limits>
#include <mutex>
#include <stdexcept>

#include "docdepth/geometry/normal.hpp"
#include "docdepth/geometry/parallel.hpp"

namespace docdepth {
namespace {

using Eigen::Vector3d;

/// A thread takes at most so many leaves of the front at once.
constexpr std::size_t kLeavesAtOnce = 8;
/// Reach of the first search for neighbours, in distances expected for evenly spread points.
constexpr double kFirstReach = 0.7;
/// After a search that was too short, reach farther than needed by this factor, for other points.
constexpr double kReachMargin = 1.2;
/// Where the nearest points lie on a line, so many times as many tell the plane.
constexpr std::size_t kWider = 8;

}  // namespace

Front::Front(const Octree& tree, const GroundParameters& parameters, bool stands, int threads,
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

void Front::seed(std::uint32_t point) {
  std::uint8_t none = kNone;
  if (!labels_[point].compare_exchange_strong(none, kReached)) return;
  seeds_.insert(std::upper_bound(seeds_.begin(), seeds_.end(), point), point);
  queue(tree_.leaf_of(point), next_);
}

void Front::grow() {
  do spread();
  while (stands_ && widen());
}

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

}  // namespace docdepth
