#include "docdepth/ground/ground.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <nanoflann.hpp>
#include <stdexcept>
#include <tuple>
#include <unordered_map>
#include <vector>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/ground/normal.hpp"

namespace docdepth {
namespace {

using Eigen::Vector3d;

constexpr std::int64_t kKeyRange = std::int64_t{1} << 20;

/// Double precision rows in the order of RigidTransform.
Vector3d transform(const Pose& T, const Vector3d& origin, const float* p) {
  Vector3d result;
  for (int i = 0; i < 3; ++i)
    result[i] = ((T(i, 0) * p[0] + T(i, 1) * p[1]) + T(i, 2) * p[2]) + (T(i, 3) - origin[i]);
  return result;
}

/// Voxel coordinates packed 21 bits an axis.
std::uint64_t voxel_key(const Vector3d& p, double voxel_size) {
  std::uint64_t key = 0;
  for (int i = 0; i < 3; ++i) {
    const double cell = std::floor(p[i] / voxel_size);
    if (!(cell >= -kKeyRange && cell < kKeyRange))
      throw std::out_of_range("a point is not finite or too far from the first pose");
    key = key << 21 | static_cast<std::uint64_t>(static_cast<std::int64_t>(cell) + kKeyRange);
  }
  return key;
}

/// Order of neighbours: nearest first, equal ones by their coordinates.
bool nearer(double distance_a, const Vector3d& a, double distance_b, const Vector3d& b) {
  return std::tie(distance_a, a.x(), a.y(), a.z()) < std::tie(distance_b, b.x(), b.y(), b.z());
}

struct Cloud {
  std::vector<Vector3d> points;

  std::size_t kdtree_get_point_count() const { return points.size(); }
  double kdtree_get_pt(std::size_t i, std::size_t axis) const { return points[i][axis]; }
  template <class Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};
using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, Cloud>, Cloud,
                                                 3, std::uint32_t>;

/// The k first of all voxels in the order of nearer().
class Nearest {
 public:
  using DistanceType = double;
  using IndexType = std::uint32_t;

  Nearest(const Cloud& cloud, std::size_t k) : cloud_(cloud), k_(k) { found_.reserve(k + 1); }

  std::size_t size() const { return found_.size(); }
  bool full() const { return found_.size() == k_; }
  /// The smallest distance that is of no use: one that equals the last may still win by
  /// coordinates.
  double worstDist() const {
    const double last = full() ? found_.back().first : std::numeric_limits<double>::infinity();
    return std::nextafter(last, std::numeric_limits<double>::infinity());
  }
  bool addPoint(double distance, std::uint32_t index) {
    const auto place = std::upper_bound(found_.begin(), found_.end(), std::pair(distance, index),
                                        [&](const auto& a, const auto& b) {
                                          return nearer(a.first, cloud_.points[a.second], b.first,
                                                        cloud_.points[b.second]);
                                        });
    found_.insert(place, {distance, index});
    if (found_.size() > k_) found_.pop_back();
    return true;
  }
  void clear() { found_.clear(); }
  const std::vector<std::pair<double, std::uint32_t>>& found() const { return found_; }

 private:
  const Cloud& cloud_;
  std::size_t k_;
  std::vector<std::pair<double, std::uint32_t>> found_;
};

}  // namespace

struct GroundMap::State {
  GroundParameters parameters;
  int threads;
  Vector3d origin = Vector3d::Zero();
  std::vector<Vector3d> positions;  // of the poses, relative to origin
  std::unordered_map<std::uint64_t, std::uint32_t> voxels;
  std::vector<Vector3d> sums;
  std::vector<std::uint32_t> counts;
  std::vector<std::atomic<bool>> ground;

  Cloud centroids() const {
    Cloud cloud;
    cloud.points.resize(sums.size());
    for (std::size_t i = 0; i < sums.size(); ++i) cloud.points[i] = sums[i] / counts[i];
    return cloud;
  }
  std::uint32_t seed(const Cloud& cloud, const Vector3d& position) const;
  std::vector<std::uint32_t> step(const Cloud& cloud, const Tree& tree, std::uint32_t point,
                                  Nearest& nearest);
};

GroundMap::GroundMap(const GroundParameters& parameters, int threads)
    : state_(new State{parameters, threads, {}, {}, {}, {}, {}, {}}) {}
GroundMap::~GroundMap() = default;

std::size_t GroundMap::size() const {
  return state_->sums.size();
}

void GroundMap::insert(const Points& points, const Pose& T_world_lidar) {
  State& map = *state_;
  if (map.positions.empty()) map.origin = T_world_lidar.translation();
  map.positions.push_back(T_world_lidar.translation() - map.origin);
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const Vector3d p = transform(T_world_lidar, map.origin, points.data() + 3 * i);
    const auto next = static_cast<std::uint32_t>(map.sums.size());
    const auto [voxel, is_new] =
        map.voxels.try_emplace(voxel_key(p, map.parameters.voxel_size), next);
    if (is_new) {
      map.sums.push_back(p);
      map.counts.push_back(1);
    } else {
      map.sums[voxel->second] += p;
      ++map.counts[voxel->second];
    }
  }
}

/// The lowest voxel within the seed radius in (X, Y), or within the first doubling that has one.
std::uint32_t GroundMap::State::seed(const Cloud& cloud, const Vector3d& position) const {
  const auto& points = cloud.points;
  for (double radius = parameters.seed_radius;; radius *= 2.0) {
    std::size_t lowest = points.size();
    for (std::size_t i = 0; i < points.size(); ++i) {
      const double dx = points[i].x() - position.x(), dy = points[i].y() - position.y();
      if (dx * dx + dy * dy > radius * radius) continue;
      if (lowest == points.size() ||
          nearer(points[i].z(), points[i], points[lowest].z(), points[lowest]))
        lowest = i;
    }
    if (lowest < points.size()) return static_cast<std::uint32_t>(lowest);
  }
}

/// Where the front goes from `point`: the voxels it labels for the first time.
std::vector<std::uint32_t> GroundMap::State::step(const Cloud& cloud, const Tree& tree,
                                                  std::uint32_t point, Nearest& nearest) {
  const Vector3d& p = cloud.points[point];
  nearest.clear();
  tree.findNeighbors(nearest, p.data(), nanoflann::SearchParams());
  if (nearest.size() < 3) return {};

  Vector3d mean = Vector3d::Zero();
  for (const auto& [distance, i] : nearest.found()) mean += cloud.points[i] - p;
  mean /= static_cast<double>(nearest.size());
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (const auto& [distance, i] : nearest.found()) {
    const Vector3d d = (cloud.points[i] - p) - mean;
    covariance += d * d.transpose();
  }
  const Vector3d normal = smallest_eigenvector(covariance);
  if (std::abs(normal.z()) < std::cos(parameters.max_slope)) return {};

  // The plane goes through the neighbours' mean and not through the point: a noisy point does not
  // tilt it away from its surface, and a seed a little below the road still reaches the road.
  std::vector<std::uint32_t> reached;
  for (const auto& [distance, i] : nearest.found())
    if (std::abs(normal.dot((cloud.points[i] - p) - mean)) < parameters.plane_distance)
      if (!ground[i].exchange(true, std::memory_order_relaxed)) reached.push_back(i);
  return reached;
}

std::size_t GroundMap::grow() {
  State& map = *state_;
  map.ground = std::vector<std::atomic<bool>>(size());
  if (!size()) return 0;
  const Cloud cloud = map.centroids();
  const Tree tree(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(16));

  std::vector<std::uint32_t> seeds(map.positions.size());
  parallel_for(seeds.size(), 1, map.threads, [&](std::size_t begin, std::size_t) {
    seeds[begin] = map.seed(cloud, map.positions[begin]);
  });
  std::vector<std::uint32_t> front;
  for (const std::uint32_t seed : seeds)
    if (!map.ground[seed].exchange(true)) front.push_back(seed);

  std::size_t count = front.size();
  while (!front.empty()) {
    constexpr std::size_t kBlock = 256;
    std::vector<std::vector<std::uint32_t>> reached((front.size() + kBlock - 1) / kBlock);
    parallel_for(front.size(), kBlock, map.threads, [&](std::size_t begin, std::size_t end) {
      Nearest nearest(cloud, map.parameters.neighbors);
      auto& mine = reached[begin / kBlock];
      for (std::size_t i = begin; i < end; ++i) {
        const auto next = map.step(cloud, tree, front[i], nearest);
        mine.insert(mine.end(), next.begin(), next.end());
      }
    });
    front.clear();
    for (const auto& part : reached) front.insert(front.end(), part.begin(), part.end());
    count += front.size();
  }
  return count;
}

void GroundMap::label(const Points& points, const Pose& T_world_lidar, bool* ground) const {
  const State& map = *state_;
  constexpr std::size_t kBlock = 8192;
  parallel_for(points.rows(), kBlock, map.threads, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Vector3d p = transform(T_world_lidar, map.origin, points.data() + 3 * i);
      const auto voxel = map.voxels.find(voxel_key(p, map.parameters.voxel_size));
      ground[i] = voxel != map.voxels.end() && voxel->second < map.ground.size() &&
                  map.ground[voxel->second].load(std::memory_order_relaxed);
    }
  });
}

}  // namespace docdepth
