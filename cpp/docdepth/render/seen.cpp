#include "docdepth/render/seen.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/rigid.hpp"
#include "docdepth/geometry/simd.hpp"
#include "docdepth/mesh/directions.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// What a ray ended on. What stands still tells nothing of what moves past it.
enum class Kind : std::uint8_t { kStatic = 0, kMoving = 1, kAny = 2 };

enum class Verdict : std::uint8_t { kNone, kEnded, kPassed, kBefore };

/// What the nearest ray of a quadrant says of a point.
struct Corner {
  float squared = std::numeric_limits<float>::infinity();  // angle [units]
  float range = 0;                                         // of its end over that of the point
  Verdict verdict = Verdict::kNone;
  Vector plane{0, 0, 0};  // where it ended, in the frame of the sweep
  std::size_t sweep = 0;
};
using Corners = std::array<Corner, 4>;

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

/// The rays of a sweep within kShutter of the image.
class ShutterRays {
 public:
  explicit ShutterRays(const PlacedRays& placed)
      : cells_(placed.rays->cells()),
        T_rays_camera_(placed.T_camera_rays.inverse()),
        first_(placed.age - kShutter),
        last_(placed.age + kShutter),
        reach_(kNearRays * cells_.spacing() / kRadiansPerUnit) {}

  /// Whether any ray is left.
  bool any() const {
    return std::any_of(cells_.time.begin(), cells_.time.end(),
                       [&](float time) { return time >= first_ && time <= last_; });
  }

  /// Whether a point in the frame of the camera lies on a plane of this frame.
  bool on_plane(const Vector& plane, const Vector& target) const {
    const Vector point = T_rays_camera_ * target;
    const float range = point.norm(), depth = plane.dot(point);
    return range * std::fabs(1 - depth) < (kSurfaceMargin + kSurfaceMarginGrowth * range) * depth;
  }

  /// Keep the nearest ray of each quadrant around a point in the frame of the camera.
  DOCDEPTH_KERNEL void find(const Vector& target, Kind kind, std::size_t number,
                            Corners& corners) const {
    const Vector point = T_rays_camera_ * target;
    const float across = std::sqrt(point.x() * point.x() + point.y() * point.y());
    const float range = std::sqrt(across * across + point.z() * point.z());
    if (!(range > 0 && range < kMaxRange)) return;
    const Direction direction = direction_of(point.x(), point.y(), point.z());
    const float cosine = std::max(across / range, kLeastCosine), inverse_range = 1 / range;
    float azimuth = float(direction.azimuth), elevation = float(direction.elevation);
    // Rays start beside the origin, so those that pass the point have other directions.
    for (int k = 0; k < 2; ++k) {
      const std::int64_t near = any_ray(azimuth, elevation);
      if (near < 0) break;
      azimuth = float(direction.azimuth) - cells_.left[near] * inverse_range / cosine;
      elevation = float(direction.elevation) - cells_.up[near] * inverse_range;
    }
    const Target to{
        point, float(direction.azimuth), float(direction.elevation), range, cosine, kind, number};
    // Most points have near rays all around: no ray beyond half the reach is nearer.
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
    std::size_t sweep;
  };

  DOCDEPTH_KERNEL static float farthest_squared(const Corners& corners) {
    return std::max(std::max(corners[0].squared, corners[1].squared),
                    std::max(corners[2].squared, corners[3].squared));
  }
  DOCDEPTH_KERNEL static float farthest(const Corners& corners) {
    return std::sqrt(farthest_squared(corners));
  }

  /// Look at the rays whose directions lie within `reach` of (azimuth, elevation).
  DOCDEPTH_KERNEL void scan(const Target& to, float azimuth, float elevation, float reach,
                            Corners& corners) const {
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
                            Corners& corners) const {
    Corner& corner = corners[(u > 0) + 2 * (v > 0)];
    if (!(squared < corner.squared) || cells_.time[i] < first_ || cells_.time[i] > last_) return;
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
  float first_, last_;  // times of rays [s after the stamp]
  float reach_;         // [units]
};

using Sweeps = std::vector<ShutterRays>;

Vector point_at(const Camera& camera, std::size_t pixel, float z) {
  const auto u = float(pixel % camera.width), v = float(pixel / camera.width);
  return {(u - float(camera.cx)) / float(camera.fx) * z,
          (v - float(camera.cy)) / float(camera.fy) * z, z};
}

Sweeps within_shutter(const std::vector<PlacedRays>& rays) {
  Sweeps sweeps;
  for (const PlacedRays& placed : rays) {
    sweeps.emplace_back(placed);
    if (!sweeps.back().any()) sweeps.pop_back();
  }
  return sweeps;
}

struct FindCorners {
  DOCDEPTH_KERNEL static void run(const Sweeps& sweeps, const Vector& point, Kind kind,
                                  Corners& corners) {
    for (std::size_t s = 0; s < sweeps.size(); ++s) sweeps[s].find(point, kind, s, corners);
  }
};

Corners corners_around(const Sweeps& sweeps, const Vector& point, Kind kind) {
  Corners corners;
  dispatch<FindCorners>(sweeps, point, kind, corners);
  return corners;
}

bool all(const Corners& corners, Verdict verdict) {
  return std::all_of(corners.begin(), corners.end(),
                     [&](const Corner& corner) { return corner.verdict == verdict; });
}

/// Whether rays around a point ended there. Where an edge passes by, some do not.
bool most_ended(const Corners& corners) {
  return std::count_if(corners.begin(), corners.end(), [](const Corner& corner) {
           return corner.verdict == Verdict::kEnded;
         }) >= kMinEnded;
}

/// Whether another surface, whose returns lie beside the pixel, may hide its point from the camera.
/// @param front  the nearest point of the image beside the pixel
bool may_be_hidden(const Sweeps& sweeps, const Vector& point, const Vector& front,
                   const Corners& corners) {
  if (front.z() + kSurfaceMargin + kSurfaceMarginGrowth * point.z() > point.z()) return false;
  for (const Corner& corner : corners)
    if (sweeps[corner.sweep].on_plane(corner.plane, front)) return false;
  const Corners before = corners_around(sweeps, front.z() / point.z() * point, Kind::kAny);
  return std::any_of(before.begin(), before.end(),
                     [](const Corner& corner) { return corner.verdict == Verdict::kEnded; });
}

/// A box as the camera sees it.
class SeenBox {
 public:
  SeenBox(const Camera& camera, const PlacedBox& box)
      : low_(-box.size.x() / 2 - kBoxMargin, -box.size.y() / 2 - kBoxMargin, 0),
        high_(box.size.x() / 2 + kBoxMargin, box.size.y() / 2 + kBoxMargin,
              box.size.z() + kBoxMargin),
        bounds_(bounds_of(camera, box.T_camera_box, {(low_ + high_) / 2, (high_ - low_) / 2})) {
    const Pose T = box.T_camera_box.inverse();
    rotation_ = T.linear().cast<float>();
    start_ = T.translation().cast<float>();
  }

  const PixelBounds& bounds() const { return bounds_; }

  /// Whether a point in the frame of the camera lies behind it.
  bool hides(const Vector& point) const {
    const Vector along = rotation_ * point;
    float enter = 0, leave = 1;  // of the way to the point
    for (int k = 0; k < 3; ++k) {
      const float a = (low_[k] - start_[k]) / along[k], b = (high_[k] - start_[k]) / along[k];
      enter = std::max(enter, std::min(a, b));
      leave = std::min(leave, std::max(a, b));
    }
    return enter < leave && leave < 1;
  }

 private:
  Vector low_, high_;
  PixelBounds bounds_;
  Eigen::Matrix3f rotation_;
  Vector start_;
};

/// The camera stands beside the sensor: what ends before the point for one of them may not hide it
/// from the other.
Seen seen_at(const Sweeps& sweeps, const Vector& point, Kind kind, const Vector& front) {
  const Corners corners = corners_around(sweeps, point, kind);
  if (all(corners, Verdict::kPassed)) return Seen::kContradicted;
  if (all(corners, Verdict::kEnded))
    return may_be_hidden(sweeps, point, front, corners) ? Seen::kNotLookedAt : Seen::kAgreed;
  if (!all(corners, Verdict::kBefore)) return Seen::kNotLookedAt;
  const Corner& nearest =
      *std::min_element(corners.begin(), corners.end(),
                        [](const Corner& a, const Corner& b) { return a.squared < b.squared; });
  const bool hidden = all(corners_around(sweeps, nearest.range * point, kind), Verdict::kEnded);
  return hidden ? Seen::kContradicted : Seen::kNotLookedAt;
}

/// The pixel with the least depth within `radius` pixels to each side and up and down.
std::vector<std::uint32_t> nearest_beside(const Camera& camera, const float* depth, int radius) {
  const int width = camera.width, height = camera.height;
  std::vector<std::uint32_t> rows(std::size_t(width) * height), result(rows.size());
  const auto take = [&](std::uint32_t& kept, std::uint32_t other) {
    if (depth[other] > 0 && !(depth[kept] <= depth[other])) kept = other;
  };
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) {
      std::uint32_t& kept = rows[std::size_t(v) * width + u] = std::uint32_t(v * width + u);
      for (int k = std::max(u - radius, 0); k <= std::min(u + radius, width - 1); ++k)
        take(kept, std::uint32_t(v * width + k));
    }
  result = rows;
  for (int v = 0; v < height; ++v)
    for (int k = std::max(v - radius, 0); k <= std::min(v + radius, height - 1); ++k)
      for (int u = 0; u < width; ++u)
        take(result[std::size_t(v) * width + u], rows[std::size_t(k) * width + u]);
  return result;
}

/// A surface goes on beyond its last return for less than the distance to the next [pixel].
int front_radius(const Camera& camera, const std::vector<PlacedRays>& rays) {
  float spacing = 0;
  for (const PlacedRays& placed : rays) spacing = std::max(spacing, placed.rays->cells().spacing());
  return std::min(int(kFrontRays * spacing * float(camera.fx)), kMostFront);
}

}  // namespace

std::vector<Seen> seen_pixels(const Camera& camera, const MeshScene& scene, const float* depth,
                              const std::vector<std::int32_t>& objects, int threads) {
  const Sweeps still = within_shutter(scene.shutter_rays);
  std::vector<Sweeps> moved;
  for (const PlacedDynamicObject& object : scene.dynamic_objects)
    moved.push_back(within_shutter(object.rays));
  const auto front = nearest_beside(camera, depth, front_radius(camera, scene.shutter_rays));
  std::vector<Seen> seen(objects.size(), Seen::kNoDepth);
  parallel_for(camera.height, 8, threads, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin * camera.width; i < end * camera.width; ++i) {
      if (!(depth[i] > 0)) continue;
      const std::int32_t k = objects[i];
      const Sweeps& sweeps = k < 0 ? still : moved[k];
      const Kind kind = k < 0 ? Kind::kStatic : Kind::kMoving;
      seen[i] = seen_at(sweeps, point_at(camera, i, depth[i]), kind,
                        point_at(camera, front[i], depth[front[i]]));
    }
  });
  return seen;
}

void empty_behind_boxes(const Camera& camera, const MeshScene& scene,
                        const std::vector<std::uint16_t>& owners, std::vector<float>& depth,
                        int threads) {
  if (scene.boxes.empty()) return;
  const Sweeps sweeps = within_shutter(scene.shutter_rays);
  std::vector<std::uint8_t> was_seen(depth.size(), 0);  // behind a box before this one
  for (const PlacedBox& placed : scene.boxes) {
    const SeenBox box(camera, placed);
    const PixelBounds& bounds = box.bounds();
    if (bounds.empty()) continue;
    const auto rows = std::size_t(bounds.end_v - bounds.begin_v);
    parallel_for(rows, 8, threads, [&](std::size_t begin, std::size_t end) {
      for (std::size_t row = begin; row < end; ++row)
        for (int u = bounds.begin_u; u < bounds.end_u; ++u) {
          const std::size_t i = (bounds.begin_v + row) * camera.width + u;
          if (was_seen[i] || !(depth[i] > 0) || (!owners.empty() && owners[i] != 0)) continue;
          const Vector point = point_at(camera, i, depth[i]);
          if (!box.hides(point)) continue;
          was_seen[i] = most_ended(corners_around(sweeps, point, Kind::kStatic));
          if (!was_seen[i]) depth[i] = std::numeric_limits<float>::quiet_NaN();
        }
    });
  }
}

}  // namespace docdepth
