#include "docdepth/render/shutter_rays.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/geometry/rigid.hpp"
#include "docdepth/geometry/simd.hpp"
#include "docdepth/mesh/directions.hpp"

namespace docdepth {

using Vector = Eigen::Vector3f;

namespace {

/// The same margins as of Rays::query_visibility().
DOCDEPTH_KERNEL Verdict verdict_of(const Rays::End& end, bool same_kind, const Vector& point,
                                   float range) {
  const float margin = kSurfaceMargin + kSurfaceMarginGrowth * range;
  const float depth =
      (end.plane.x() * point.x() + end.plane.y() * point.y()) + end.plane.z() * point.z();
  if (std::fabs(end.range - range) < margin || range * std::fabs(1 - depth) < margin * depth)
    return same_kind ? Verdict::kEnded : Verdict::kNone;
  if (end.range > range + margin && depth < 1) return Verdict::kPassed;
  return same_kind && end.range < range - margin ? Verdict::kBefore : Verdict::kNone;
}

}  // namespace

/// The rays of one sweep.
class ShutterRays::Sweep {
 public:
  explicit Sweep(const SweepRays& placed)
      : cells_(placed.rays->cells()),
        T_rays_camera_(placed.T_camera_rays.inverse()),
        age_(placed.age),
        reach_(kNearRays * cells_.spacing() / kRadiansPerUnit) {}

  /// Whether some ray may have been measured within a time of the image [s].
  bool any(float within) const {
    return cells_.first_time - age_ <= within && age_ - cells_.last_time <= within;
  }

  bool on_plane(const Vector& plane, const Vector& target) const {
    const Vector point = T_rays_camera_ * target;
    const float range = point.norm(), depth = plane.dot(point);
    return range * std::fabs(1 - depth) < (kSurfaceMargin + kSurfaceMarginGrowth * range) * depth;
  }

  float apart(const Vector& a, const Vector& b) const {
    const Vector from = (T_rays_camera_ * a).normalized(), to = (T_rays_camera_ * b).normalized();
    return (from - to).norm() / cells_.spacing();
  }

  DOCDEPTH_KERNEL void find(const Place& place, std::size_t number, QuadrantRays& corners) const {
    if (!any(place.within)) return;
    const bool moves = !place.velocity.isZero(0);
    Target to = target(place.point, place, number);
    if (!to.in_range()) return;
    float azimuth = to.azimuth, elevation = to.elevation;
    // Rays start beside the origin, so those that pass the place have other directions. And they
    // were not all fired at the same time.
    for (int k = 0; k < 2; ++k) {
      const std::int64_t near = any_ray(azimuth, elevation);
      if (near < 0) break;
      if (moves)
        to = target(place.point + place.velocity * (cells_.time[near] - age_), place, number);
      if (!to.in_range()) return;
      const float inverse_range = 1 / to.range;
      azimuth = to.azimuth - cells_.left[near] * inverse_range / to.cosine;
      elevation = to.elevation - cells_.up[near] * inverse_range;
    }
    // Most places have near rays all around: no ray beyond half the reach is nearer.
    for (const float reach : {reach_ / 2, reach_}) {
      scan(to, azimuth, elevation, std::min(reach, farthest(corners)), corners);
      if (farthest(corners) <= reach) return;
    }
  }

 private:
  static constexpr float kLeastCosine = 0.1f;  // straight up there are no columns

  struct Target {
    Vector point;
    float azimuth, elevation, range, cosine;
    Kind kind;
    float within;  // [s]
    std::size_t sweep;

    DOCDEPTH_KERNEL bool in_range() const { return range > 0 && range < kMaxRange; }
  };

  DOCDEPTH_KERNEL Target target(const Vector& point, const Place& place, std::size_t number) const {
    const Vector p = T_rays_camera_ * point;
    const float across = std::sqrt(p.x() * p.x() + p.y() * p.y());
    Target to{p,     0, 0, std::sqrt(across * across + p.z() * p.z()), 1, place.kind, place.within,
              number};
    if (!to.in_range()) return to;
    const Direction direction = direction_of(p.x(), p.y(), p.z());
    to.azimuth = float(direction.azimuth);
    to.elevation = float(direction.elevation);
    to.cosine = std::max(across / to.range, kLeastCosine);
    return to;
  }

  DOCDEPTH_KERNEL static float farthest_squared(const QuadrantRays& corners) {
    return std::max(std::max(corners[0].squared, corners[1].squared),
                    std::max(corners[2].squared, corners[3].squared));
  }
  DOCDEPTH_KERNEL static float farthest(const QuadrantRays& corners) {
    return std::sqrt(farthest_squared(corners));
  }

  /// Look at the rays whose directions lie within `reach` of (azimuth, elevation).
  DOCDEPTH_KERNEL void scan(const Target& to, float azimuth, float elevation, float reach,
                            QuadrantRays& corners) const {
    const int low = std::max(row_of(elevation - reach), 0);
    const int high = std::min(row_of(elevation + reach), cells_.rows - 1);
    if (low > high) return;
    const int left = column_of(azimuth - reach / to.cosine);
    const int right = std::min(column_of(azimuth + reach / to.cosine), left + cells_.columns - 1);
    const float inverse_range = 1 / to.range;
    float most = farthest_squared(corners);
    for (int k = left; k <= right; ++k) {
      const int column = wrapped(k);
      const float from = to.azimuth - float((k - column) / cells_.columns) * kTurn;
      const int place = cells_.place(column);
      if (place == cells_.used) continue;
      const std::uint32_t* start = &cells_.start[std::size_t(place) * cells_.rows];
      const std::uint32_t end = start[high + 1];
      for (std::uint32_t i = start[low]; i < end; i += kLanes) {
        const Floats u =
            (load(&cells_.azimuth[i]) - from) * to.cosine + load(&cells_.left[i]) * inverse_range;
        const Floats v =
            (load(&cells_.elevation[i]) - to.elevation) + load(&cells_.up[i]) * inverse_range;
        const Floats squared = u * u + v * v;
        const Ints near = (squared < most) & (absolute(u) <= reach_) & (absolute(v) <= reach_);
        if (!docdepth::any(near)) continue;  // of most eight
        const int some = std::min<int>(end - i, kLanes);
        for (int lane = 0; lane < some; ++lane)
          if (near[lane]) take(to, i + lane, u[lane], v[lane], squared[lane], corners);
        most = farthest_squared(corners);
      }
    }
  }

  /// Keep ray i if it is nearer than what its quadrant has.
  DOCDEPTH_KERNEL void take(const Target& to, std::uint32_t i, float u, float v, float squared,
                            QuadrantRays& corners) const {
    QuadrantRay& corner = corners[(u > 0) + 2 * (v > 0)];
    if (!(squared < corner.squared) || std::fabs(cells_.time[i] - age_) > to.within) return;
    const Rays::End& end = cells_.ends[i];
    const bool same_kind = to.kind == Kind::kAny || Kind(cells_.moving[i]) == to.kind;
    corner = {squared, end.range * (1 / to.range), verdict_of(end, same_kind, to.point, to.range),
              end.plane, to.sweep};
  }

  DOCDEPTH_KERNEL int row_of(float elevation) const {
    return int(std::floor((elevation - float(cells_.low)) / float(cells_.side)));
  }
  DOCDEPTH_KERNEL int column_of(float azimuth) const {
    return int(std::floor((azimuth + kTurn / 2) * float(cells_.columns) / float(kTurn)));
  }
  DOCDEPTH_KERNEL int wrapped(int column) const {
    return (column % cells_.columns + cells_.columns) % cells_.columns;
  }

  /// A ray in the cell of a direction or in one beside it; -1 if there is none.
  DOCDEPTH_KERNEL std::int64_t any_ray(float azimuth, float elevation) const {
    const int row = row_of(elevation), column = column_of(azimuth);
    for (const int r : {row, row - 1, row + 1})
      for (const int c : {column, column - 1, column + 1}) {
        if (r < 0 || r >= cells_.rows) continue;
        const int place = cells_.place(wrapped(c));
        if (place == cells_.used) continue;
        const std::uint32_t* start = &cells_.start[std::size_t(place) * cells_.rows + r];
        if (start[0] < start[1]) return start[0];
      }
    return -1;
  }

  const Rays::Cells& cells_;
  RigidTransform T_rays_camera_;
  float age_;    // of the image [s after the stamp]
  float reach_;  // [units]
};

struct ShutterRays::FindRays {
  DOCDEPTH_KERNEL static void run(const std::vector<Sweep>& sweeps, const Place& place,
                                  QuadrantRays& corners) {
    for (std::size_t s = 0; s < sweeps.size(); ++s) sweeps[s].find(place, s, corners);
  }
};

ShutterRays::ShutterRays(const std::vector<SweepRays>& rays) {
  for (const SweepRays& placed : rays) sweeps_.emplace_back(placed);
}

ShutterRays::ShutterRays(ShutterRays&&) noexcept = default;

ShutterRays::~ShutterRays() = default;

QuadrantRays ShutterRays::around(const Place& place) const {
  QuadrantRays corners;
  dispatch<FindRays>(sweeps_, place, corners);
  return corners;
}

bool ShutterRays::on_plane(const QuadrantRay& corner, const Vector& point) const {
  return sweeps_[corner.sweep].on_plane(corner.plane, point);
}

float ShutterRays::apart(const Vector& a, const Vector& b) const {
  float most = 0;
  for (const Sweep& sweep : sweeps_) most = std::max(most, sweep.apart(a, b));
  return most;
}

int count(const QuadrantRays& corners, std::initializer_list<Verdict> verdicts) {
  return int(std::count_if(corners.begin(), corners.end(), [&](const QuadrantRay& corner) {
    return std::find(verdicts.begin(), verdicts.end(), corner.verdict) != verdicts.end();
  }));
}

}  // namespace docdepth
