#include "docdepth/detections/classification.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "docdepth/detections/connectivity.hpp"
#include "docdepth/detections/detections.hpp"
#include "docdepth/geometry/sampled_points.hpp"

namespace docdepth {
namespace {

/// A place is clearly free if more than so many times as many key frames found it free as occupied.
constexpr int kMinFreeRatio = 2;

using Flags = std::vector<std::uint8_t>;

/// One value per object. Most points are not the first of an object, so values are kept apart.
template <class Value>
class ByObject {
 public:
  explicit ByObject(std::size_t points) : number_(points, kUnknown) {}

  /// The value of the object with that first point.
  Value& operator[](std::uint32_t first) {
    if (number_[first] == kUnknown) {
      number_[first] = static_cast<std::uint32_t>(values_.size());
      values_.emplace_back();
    }
    return values_[number_[first]];
  }
  const std::vector<Value>& values() const { return values_; }

 private:
  static constexpr std::uint32_t kUnknown = 0xffffffff;
  std::vector<std::uint32_t> number_;
  std::vector<Value> values_;
};

/// What the votes say about each point.
struct Evidence {
  Flags voted, dynamic, observed_free, observed_occupied;
  bool any = false;  ///< anything but static points

  Evidence(std::size_t count, const std::uint16_t* statics, const std::uint16_t* dynamics,
           const ClassificationOptions& options)
      : voted(count), dynamic(count), observed_free(count), observed_occupied(count) {
    for (std::size_t i = 0; i < count; ++i) {
      voted[i] = statics[i] || dynamics[i];
      dynamic[i] = dynamics[i] > statics[i];
      observed_occupied[i] = statics[i] >= options.max_static_ratio *
                                               static_cast<float>(std::max<int>(dynamics[i], 1));
      observed_free[i] = dynamics[i] >= options.observed_free_votes &&
                         options.max_static_ratio * static_cast<float>(dynamics[i]) >
                             static_cast<float>(statics[i]);
      any |= dynamic[i] || observed_free[i];
    }
  }
};

struct Object {
  int points = 0, voted = 0, dynamic = 0, observed_free = 0, occupied_once = 0;
  bool has_isolated = false;
  float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};

  bool moves(const ClassificationOptions& options) const {
    const auto found = static_cast<float>(dynamic);
    return points >= options.min_object_points &&
           found >= options.dynamic_share * static_cast<float>(voted) &&
           found >= options.min_dynamic_share * static_cast<float>(points);
  }
  /// Whether it is dynamic but stands for a while: much of its place was free, and occupied in one
  /// stretch of time. Rays pass through twigs and fences, so that these are found free and occupied
  /// in turn; objects with isolated returns are left out, too.
  bool stands(const ClassificationOptions& options) const {
    const float x = high[0] - low[0], y = high[1] - low[1];
    return points >= options.min_object_points && !has_isolated &&
           high[2] - low[2] >= options.min_object_height &&
           x * x + y * y >= options.min_object_width * options.min_object_width &&
           static_cast<float>(observed_free) >=
               options.observed_free_share * static_cast<float>(points) &&
           static_cast<float>(occupied_once) >=
               options.occupied_once_share * static_cast<float>(observed_free);
  }
};

/// Finds whether a marked point is near, by cells of that size.
class MarkedPoints {
 public:
  MarkedPoints(const Points& points, const Flags& marked, float distance)
      : points_(points), distance_(distance) {
    for (std::uint32_t i = 0; i < marked.size(); ++i)
      if (marked[i]) cells_[voxel_key(points.row(i), distance)].push_back(i);
  }
  bool has_near(std::uint32_t i) const {
    for (int x = -1; x <= 1; ++x)
      for (int y = -1; y <= 1; ++y)
        for (int z = -1; z <= 1; ++z) {
          const auto found = cells_.find(voxel_key(cell(i, 0) + x, cell(i, 1) + y, cell(i, 2) + z));
          if (found == cells_.end()) continue;
          for (const auto j : found->second)
            if (squared_distance(points_, i, j) < distance_ * distance_) return true;
        }
    return false;
  }

 private:
  std::int64_t cell(std::uint32_t i, int axis) const {
    return voxel_coordinate(points_(i, axis), distance_);
  }

  const Points& points_;
  float distance_;
  std::unordered_map<std::uint64_t, std::vector<std::uint32_t>> cells_;
};

/// Dynamic points that are connected to enough others. Ground points only count if together they
/// rise like an object: voting is so exact above a level plane that a bump of it seems to have been
/// free.
Flags confirmed_points(const Points& points, const bool* ground, const ScanMesh& mesh,
                       const Flags& dynamic, const ClassificationOptions& options) {
  DisjointSets joined(dynamic.size());
  const auto is_dynamic = [&](std::uint32_t i) { return dynamic[i] != 0; };
  join_corners(points, mesh, false, options.clustering.distance, options.clustering.distance_growth,
               is_dynamic, joined);
  const auto first = joined.first();
  struct Cluster {
    int points = 0, above_ground = 0;
    float low = INFINITY, high = -INFINITY;
  };
  ByObject<Cluster> clusters(first.size());
  for (std::size_t i = 0; i < first.size(); ++i) {
    if (!dynamic[i]) continue;
    Cluster& cluster = clusters[first[i]];
    ++cluster.points;
    cluster.above_ground += !ground[i];
    cluster.low = std::min(cluster.low, points(i, 2));
    cluster.high = std::max(cluster.high, points(i, 2));
  }
  Flags result(first.size());
  for (std::size_t i = 0; i < first.size(); ++i) {
    if (!dynamic[i]) continue;
    const Cluster& cluster = clusters[first[i]];
    const bool rises = cluster.high - cluster.low >= options.min_object_height;
    result[i] = (rises ? cluster.points : cluster.above_ground) >= options.min_cluster_size;
  }
  return result;
}

/// Add all points of dynamic objects, except those of static things that are connected to them.
void add_objects(const Points& points, const bool* ground, const std::uint32_t* first,
                 const bool* occupied_once, const ScanMesh& mesh, const Evidence& evidence,
                 const ClassificationOptions& options, Flags& dynamic) {
  const std::size_t count = dynamic.size();
  ByObject<Object> objects(count);
  for (std::size_t i = 0; i < count; ++i) {
    if (ground[i]) continue;
    Object& object = objects[first[i]];
    ++object.points;
    object.voted += evidence.voted[i];
    object.dynamic += evidence.dynamic[i];
    object.observed_free += evidence.observed_free[i];
    object.occupied_once += evidence.observed_free[i] && occupied_once[i];
    for (int axis = 0; axis < 3; ++axis) {
      object.low[axis] = std::min(object.low[axis], points(i, axis));
      object.high[axis] = std::max(object.high[axis], points(i, axis));
    }
  }
  for (const auto i : mesh.isolated)
    if (!ground[i]) objects[first[i]].has_isolated = true;
  for (std::size_t i = 0; i < count; ++i) {
    if (ground[i]) continue;
    const Object& object = objects[first[i]];
    if (object.moves(options) ? !evidence.observed_occupied[i] : object.stands(options))
      dynamic[i] = 1;
  }
}

}  // namespace

std::vector<std::uint8_t> classify_objects(const Points& points, const bool* ground,
                                           const std::uint32_t* objects,
                                           const std::uint16_t* static_votes,
                                           const std::uint16_t* dynamic_votes,
                                           const bool* occupied_once, const ScanMesh& mesh,
                                           const ClassificationOptions& options) {
  const auto count = static_cast<std::size_t>(points.rows());
  const Evidence evidence(count, static_votes, dynamic_votes, options);
  if (!evidence.any) return evidence.dynamic;
  Flags dynamic = confirmed_points(points, ground, mesh, evidence.dynamic, options);
  add_objects(points, ground, objects, occupied_once, mesh, evidence, options, dynamic);

  const MarkedPoints confirmed(points, dynamic, options.neighbor_radius);
  for (std::uint32_t i = 0; i < count; ++i) {
    if (dynamic[i] || !evidence.dynamic[i]) continue;
    const bool clear = !ground[i] && dynamic_votes[i] >= options.clear_votes &&
                       dynamic_votes[i] > kMinFreeRatio * static_votes[i] && occupied_once[i];
    dynamic[i] = clear || confirmed.has_near(i);
  }
  add_isolated_points(points, ground, objects, static_votes, dynamic_votes, dynamic, options);
  return dynamic;
}

void add_isolated_points(const Points& points, const bool* ground, const std::uint32_t* objects,
                         const std::uint16_t* static_votes, const std::uint16_t* dynamic_votes,
                         Flags& dynamic, const ClassificationOptions& options) {
  const std::size_t count = dynamic.size();
  struct Whole {
    std::uint32_t points = 0, dynamic = 0;
    Extent extent;
  };
  ByObject<Whole> wholes(count);
  const auto at = [&](std::size_t i) { return Extent{points.row(i), points.row(i)}; };
  for (std::size_t i = 0; i < count; ++i) {
    if (ground[i]) continue;
    Whole& object = wholes[objects[i]];
    if (object.points++ == 0) object.extent = at(i);
    object.extent.add(at(i));
    object.dynamic += dynamic[i] != 0;
  }
  std::vector<Extent> boxes;
  for (const Whole& object : wholes.values())
    if (int(object.points) >= options.min_object_points && 2 * object.dynamic >= object.points &&
        object.extent.width() <= kMaxObjectWidth)
      boxes.push_back(object.extent);
  for (std::size_t i = 0; i < count; ++i) {
    if (dynamic[i] || ground[i] || wholes[objects[i]].points >= kMinDetectionPoints) continue;
    if (static_votes[i] > dynamic_votes[i] + options.isolated_votes) continue;
    dynamic[i] = std::any_of(boxes.begin(), boxes.end(),
                             [&](const Extent& box) { return box.overlaps(at(i), kObjectMargin); });
  }
}

}  // namespace docdepth
