#include "docdepth/dynamics/objects.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <unordered_map>

#include "docdepth/dynamics/moving_cubes.hpp"
#include "docdepth/geometry/rigid.hpp"
#include "docdepth/geometry/spherical.hpp"

namespace docdepth {
namespace {

using Edge = std::array<std::uint32_t, 2>;
using Flags = std::vector<std::uint8_t>;

float squared_distance(const Points& points, std::uint32_t a, std::uint32_t b) {
  const float x = points(a, 0) - points(b, 0), y = points(a, 1) - points(b, 1),
              z = points(a, 2) - points(b, 2);
  return (x * x + y * y) + z * z;
}

/// Sets of points that are joined one by one.
class Sets {
 public:
  explicit Sets(std::size_t count) : parent_(count) {
    std::iota(parent_.begin(), parent_.end(), 0u);
  }
  std::uint32_t find(std::uint32_t a) {
    while (parent_[a] != a) a = parent_[a] = parent_[parent_[a]];
    return a;
  }
  /// Without a search: false says nothing.
  bool have_joined(std::uint32_t a, std::uint32_t b) const { return parent_[a] == parent_[b]; }
  void join(std::uint32_t a, std::uint32_t b) {
    a = find(a);
    b = find(b);
    if (a != b) parent_[std::max(a, b)] = std::min(a, b);
  }
  /// The first point of each one's set.
  std::vector<std::uint32_t> first() {
    std::vector<std::uint32_t> result(parent_.size());
    for (std::uint32_t i = 0; i < result.size(); ++i) result[i] = find(i);
    return result;
  }

 private:
  std::vector<std::uint32_t> parent_;
};

/// Join those points that `takes_part` and are corners of one triangle, of those that are cut or of
/// the others, where they are no farther apart than `near`, or `growth` times their range.
template <class TakesPart>
void join_corners(const Points& points, const ScanMesh& mesh, bool cut, float near, float growth,
                  const TakesPart& takes_part, Sets& sets) {
  const auto range = [&](std::uint32_t i) {
    return range_of(points(i, 0), points(i, 1), points(i, 2));
  };
  const auto linked = [&](std::uint32_t a, std::uint32_t b) {
    const float squared = squared_distance(points, a, b);
    if (squared < near * near) return true;  // as most are, whatever their range
    const float link = growth * std::min(range(a), range(b));
    return squared < link * link;
  };
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (bool(mesh.discontinuity[t]) != cut) continue;
    const auto& corners = mesh.triangles[t];
    const bool in[3] = {takes_part(corners[0]), takes_part(corners[1]), takes_part(corners[2])};
    if (in[0] + in[1] + in[2] < 2) continue;
    for (int i = 0, j = 2; i < 3; j = i++)
      if (in[i] && in[j] && !sets.have_joined(corners[i], corners[j]) &&
          linked(corners[i], corners[j]))
        sets.join(corners[i], corners[j]);
  }
}

/// What is known about each object, one after the other; most points are the first one of none.
template <class Value>
class ByObject {
 public:
  explicit ByObject(std::size_t points) : place_(points, kNone) {}

  /// Of the object with that first point.
  Value& operator[](std::uint32_t first) {
    if (place_[first] == kNone) {
      place_[first] = static_cast<std::uint32_t>(values_.size());
      values_.emplace_back();
    }
    return values_[place_[first]];
  }
  const std::vector<Value>& values() const { return values_; }

 private:
  static constexpr std::uint32_t kNone = 0xffffffff;
  std::vector<std::uint32_t> place_;
  std::vector<Value> values_;
};

/// What is known about connected points.
struct Object {
  int points = 0, voted = 0, dynamic = 0, freed = 0;
  bool in_pieces = false;  ///< some of its returns are in no triangle
  float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};

  /// Most of what was seen of it is dynamic.
  bool moves(const ObjectParameters& p) const {
    const auto found = static_cast<float>(dynamic);
    return points >= p.min_object_points && found >= p.dynamic_share * static_cast<float>(voted) &&
           found >= p.min_dynamic_share * static_cast<float>(points);
  }
  /// It stands for a while, and most of its place was seen free. Of what is in pieces nobody can
  /// tell: key frames look past twigs and fences, so that they seem to be free now and then.
  bool stays(const ObjectParameters& p) const {
    const float x = high[0] - low[0], y = high[1] - low[1];
    return points >= p.min_object_points && !in_pieces && high[2] - low[2] >= p.min_object_height &&
           x * x + y * y >= p.min_object_width * p.min_object_width &&
           static_cast<float>(freed) >= p.observed_free_share * static_cast<float>(points);
  }
};

constexpr std::uint32_t kFewestPoints = 5;  ///< of what is an object
constexpr float kPieces = 0.03f;            ///< `link_growth` of what is in pieces
constexpr float kWidest = 25;               ///< of what moves, from above [m]
constexpr float kAround = 0.2f;             ///< an extent, and a box on its way [m]

/// Finds whether a marked point lies near, by cells of that size.
class Neighborhood {
 public:
  Neighborhood(const Points& points, const Flags& marked, float distance)
      : points_(points), distance_(distance) {
    for (std::uint32_t i = 0; i < marked.size(); ++i)
      if (marked[i]) cells_[key(cell(i, 0), cell(i, 1), cell(i, 2))].push_back(i);
  }
  bool has_near(std::uint32_t i) const {
    for (int x = -1; x <= 1; ++x)
      for (int y = -1; y <= 1; ++y)
        for (int z = -1; z <= 1; ++z) {
          const auto found = cells_.find(key(cell(i, 0) + x, cell(i, 1) + y, cell(i, 2) + z));
          if (found == cells_.end()) continue;
          for (const auto j : found->second)
            if (squared_distance(points_, i, j) < distance_ * distance_) return true;
        }
    return false;
  }

 private:
  std::int64_t cell(std::uint32_t i, int axis) const {
    return static_cast<std::int64_t>(std::floor(points_(i, axis) / distance_));
  }
  static std::int64_t key(std::int64_t x, std::int64_t y, std::int64_t z) {
    constexpr std::int64_t kSpan = 1 << 21;
    return ((x & (kSpan - 1)) * kSpan + (y & (kSpan - 1))) * kSpan + (z & (kSpan - 1));
  }

  const Points& points_;
  float distance_;
  std::unordered_map<std::int64_t, std::vector<std::uint32_t>> cells_;
};

/// Dynamic points of their own right that are connected to enough others. Those that are called
/// ground do not count, unless together they rise like an object: key frames tell so exactly what
/// lies above a level plane that some bump of it seems to have been free.
Flags believed(const Points& points, const bool* ground, const ScanMesh& mesh, const Flags& dynamic,
               const ObjectParameters& p) {
  Sets joined(dynamic.size());
  const auto is_dynamic = [&](std::uint32_t i) { return dynamic[i] != 0; };
  join_corners(points, mesh, false, p.cluster_distance, p.cluster_distance_growth, is_dynamic,
               joined);
  const auto first = joined.first();
  struct Connected {
    int points = 0, off_ground = 0;
    float low = INFINITY, high = -INFINITY;
  };
  ByObject<Connected> sets(first.size());
  for (std::size_t i = 0; i < first.size(); ++i) {
    if (!dynamic[i]) continue;
    Connected& set = sets[first[i]];
    ++set.points;
    set.off_ground += !ground[i];
    set.low = std::min(set.low, points(i, 2));
    set.high = std::max(set.high, points(i, 2));
  }
  Flags result(first.size());
  for (std::size_t i = 0; i < first.size(); ++i) {
    if (!dynamic[i]) continue;
    const Connected& set = sets[first[i]];
    const bool rises = set.high - set.low >= p.min_object_height;
    result[i] = (rises ? set.points : set.off_ground) >= p.min_cluster_size;
  }
  return result;
}

/// All points of the objects that move, but for those of what stands beside and is connected to it.
void add_objects(const Points& points, const bool* ground, const std::uint32_t* first,
                 const ScanMesh& mesh, const Flags& voted, const Flags& dynamic, const Flags& freed,
                 const Flags& stood, const ObjectParameters& p, Flags& moving) {
  const std::size_t count = moving.size();
  ByObject<Object> objects(count);
  for (std::size_t i = 0; i < count; ++i) {
    if (ground[i]) continue;
    Object& object = objects[first[i]];
    ++object.points;
    object.voted += voted[i];
    object.dynamic += dynamic[i];
    object.freed += freed[i];
    for (int axis = 0; axis < 3; ++axis) {
      object.low[axis] = std::min(object.low[axis], points(i, axis));
      object.high[axis] = std::max(object.high[axis], points(i, axis));
    }
  }
  for (const auto i : mesh.isolated)
    if (!ground[i]) objects[first[i]].in_pieces = true;
  for (std::size_t i = 0; i < count; ++i) {
    if (ground[i]) continue;
    const Object& object = objects[first[i]];
    if (object.moves(p) ? !stood[i] : object.stays(p)) moving[i] = 1;
  }
}

}  // namespace

std::vector<std::uint32_t> cluster_objects(const Points& points, const bool* ground,
                                           const ScanMesh& mesh, const ObjectParameters& p) {
  Sets sets(points.rows());
  const auto off_ground = [&](std::uint32_t i) { return !ground[i]; };
  join_corners(points, mesh, false, p.cluster_distance, p.cluster_distance_growth, off_ground,
               sets);
  auto first = sets.first();
  std::vector<std::uint32_t> size(first.size());
  for (const auto f : first) ++size[f];
  Flags piece(first.size());
  for (std::uint32_t i = 0; i < piece.size(); ++i)
    piece[i] = !ground[i] && size[first[i]] < kFewestPoints;
  const auto in_pieces = [&](std::uint32_t i) { return piece[i] != 0; };
  join_corners(points, mesh, true, p.cluster_distance, kPieces, in_pieces, sets);
  for (std::uint32_t i = 0; i < piece.size(); ++i)
    if (piece[i]) first[i] = sets.find(i);
  return first;
}

std::vector<std::uint8_t> classify_objects(const Points& points, const bool* ground,
                                           const std::uint32_t* first, const std::uint16_t* statics,
                                           const std::uint16_t* dynamics, const ScanMesh& mesh,
                                           const ObjectParameters& p) {
  const auto count = static_cast<std::size_t>(points.rows());
  Flags voted(count), dynamic(count), freed(count), stood(count);
  bool any = false;
  for (std::size_t i = 0; i < count; ++i) {
    voted[i] = statics[i] || dynamics[i];
    dynamic[i] = dynamics[i] > statics[i];
    stood[i] = statics[i] >= p.max_static_ratio * static_cast<float>(std::max<int>(dynamics[i], 1));
    freed[i] =
        dynamics[i] >= p.observed_free_votes &&
        p.max_static_ratio * static_cast<float>(dynamics[i]) > static_cast<float>(statics[i]);
    any |= dynamic[i] || freed[i];
  }
  if (!any) return dynamic;
  Flags moving = believed(points, ground, mesh, dynamic, p);
  add_objects(points, ground, first, mesh, voted, dynamic, freed, stood, p, moving);

  const Neighborhood neighborhood(points, moving, p.neighbor_radius);
  for (std::uint32_t i = 0; i < count; ++i) {
    if (moving[i] || !dynamic[i]) continue;
    const bool clear = !ground[i] && dynamics[i] >= p.clear_votes &&
                       static_cast<float>(dynamics[i]) > p.clear_ratio * statics[i];
    moving[i] = clear || neighborhood.has_near(i);
  }
  add_isolated_points(points, ground, first, statics, dynamics, p, moving);
  return moving;
}

void add_isolated_points(const Points& points, const bool* ground, const std::uint32_t* first,
                         const std::uint16_t* statics, const std::uint16_t* dynamics,
                         const ObjectParameters& p, Flags& moving) {
  const std::size_t count = moving.size();
  struct Whole {
    std::uint32_t points = 0, moving = 0;
    Extent extent;
  };
  ByObject<Whole> objects(count);
  const auto at = [&](std::size_t i) { return Extent{points.row(i), points.row(i)}; };
  for (std::size_t i = 0; i < count; ++i) {
    if (ground[i]) continue;
    Whole& object = objects[first[i]];
    if (object.points++ == 0) object.extent = at(i);
    object.extent.add(at(i));
    object.moving += moving[i] != 0;
  }
  std::vector<Extent> movers;
  for (const Whole& object : objects.values())
    if (int(object.points) >= p.min_object_points && 2 * object.moving >= object.points &&
        object.extent.width() <= kWidest)
      movers.push_back(object.extent);
  for (std::size_t i = 0; i < count; ++i) {
    if (moving[i] || ground[i] || objects[first[i]].points >= kFewestPoints) continue;
    if (statics[i] > dynamics[i] + p.isolated_votes) continue;
    moving[i] = std::any_of(movers.begin(), movers.end(),
                            [&](const Extent& mover) { return mover.overlaps(at(i), kAround); });
  }
}

void add_points_inside(const Points& points, const bool* ground, const std::uint16_t* statics,
                       const std::uint16_t* dynamics, const Pose& T_world_lidar,
                       const std::vector<Extent>& boxes, const std::vector<std::uint64_t>& cubes,
                       const ObjectParameters& p, Flags& moving) {
  const RigidTransform T(T_world_lidar);
  for (std::size_t i = 0; i < moving.size(); ++i) {
    if (moving[i] || ground[i] || statics[i] > dynamics[i] + p.isolated_votes) continue;
    const Eigen::Vector3f at = T * Eigen::Vector3f(points(i, 0), points(i, 1), points(i, 2));
    moving[i] = std::any_of(boxes.begin(), boxes.end(),
                            [&](const Extent& box) { return box.overlaps({at, at}, kAround); }) ||
                std::binary_search(cubes.begin(), cubes.end(), cube_of(at));
  }
}

}  // namespace docdepth
