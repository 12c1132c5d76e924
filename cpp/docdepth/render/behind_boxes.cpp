#include "docdepth/render/behind_boxes.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/render/shutter_rays.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// An object may reach this far beyond the box of its track [m]: what was seen of it is not all.
constexpr float kBoxMargin = 0.05f;
/// Pixels of a cell share one way through the box, and if they are at the same depth what rays say
/// of the place behind it. A cell is as wide as rays are apart, but within these bounds [pixel].
constexpr float kLeastCell = 2, kMostCell = 4;
/// The way through the box is looked at in so many places at most.
constexpr int kMostPlaces = 8;
/// Rays beyond kShutter count, too, while the object goes no farther than this [m].
constexpr float kMostTravel = 1.0f;

/// Depths between which a ray of the camera is inside a box; none if `leave` is not more.
struct Inside {
  float enter, leave;

  bool ends_before(float depth) const { return enter < leave && leave < depth; }
};

/// A box as the camera sees it.
class SeenBox {
 public:
  SeenBox(const Camera& camera, const ObjectBox& box)
      : low_(-box.size.x() / 2 - kBoxMargin, -box.size.y() / 2 - kBoxMargin, 0),
        high_(box.size.x() / 2 + kBoxMargin, box.size.y() / 2 + kBoxMargin,
              box.size.z() + kBoxMargin),
        velocity_(box.velocity),
        within_(std::max(kShutter, kMostTravel / box.velocity.norm())),
        bounds_(bounds_of(camera, box.T_camera_box, {(low_ + high_) / 2, (high_ - low_) / 2})) {
    const Pose T = box.T_camera_box.inverse();
    rotation_ = T.linear().cast<float>();
    start_ = T.translation().cast<float>();
  }

  const PixelBounds& bounds() const { return bounds_; }
  float within() const { return within_; }  ///< time between rays that count and the image [s]

  /// @param ray  of the camera, with a depth of 1
  Inside inside(const Vector& ray) const {
    const Vector along = rotation_ * ray;
    Inside inside{0, std::numeric_limits<float>::infinity()};
    for (int k = 0; k < 3; ++k) {
      const float a = (low_[k] - start_[k]) / along[k], b = (high_[k] - start_[k]) / along[k];
      inside.enter = std::max(inside.enter, std::min(a, b));
      inside.leave = std::min(inside.leave, std::max(a, b));
    }
    return inside;
  }

  /// Whether rays around the shutter tell that the object is nowhere along the way through its box.
  bool is_empty_along(const Vector& ray, const ShutterRays& rays) const {
    const auto [enter, leave] = inside(ray);
    if (!(enter < leave)) return true;
    const float apart = std::min(rays.apart(ray * enter, ray * leave), float(kMostPlaces));
    const int places = std::max(int(std::ceil(apart)), 1);
    for (int k = 0; k < places; ++k) {
      const float depth = enter + (leave - enter) * (float(k) + 0.5f) / float(places);
      const QuadrantRays corners = rays.around({ray * depth, Kind::kStatic, velocity_, within_});
      // Where a ray ended on what stands still, that is there and not the object.
      if (count(corners, {Verdict::kPassed, Verdict::kEnded}) < int(corners.size())) return false;
    }
    return true;
  }

 private:
  Vector low_, high_, velocity_;
  float within_;
  PixelBounds bounds_;
  Eigen::Matrix3f rotation_;
  Vector start_;
};

int cell_of(const Camera& camera, const std::vector<SweepRays>& rays) {
  float spacing = std::numeric_limits<float>::infinity();
  for (const SweepRays& placed : rays) spacing = std::min(spacing, placed.rays->cells().spacing());
  return int(std::clamp(std::round(spacing * float(camera.fx)), kLeastCell, kMostCell));
}

/// Pixels of a box that show the static world, a cell at a time.
class BoxBackground {
 public:
  BoxBackground(const Camera& camera, const SeenBox& box, const ShutterRays& rays, int cell)
      : camera_(camera), box_(box), rays_(rays), cell_(cell) {}

  /// @param is_world  1 for pixels behind a box before this one at which rays ended on the world
  void empty(int from_u, int from_v, const std::vector<std::uint16_t>& shown_objects,
             std::vector<std::uint8_t>& is_world, std::vector<float>& depth) const {
    const PixelBounds& bounds = box_.bounds();
    const float middle = float(cell_ - 1) / 2;
    std::optional<bool> is_empty;  // along the way of the middle
    CachedAnswer cached;
    for (int v = from_v; v < std::min(from_v + cell_, bounds.end_v); ++v)
      for (int u = from_u; u < std::min(from_u + cell_, bounds.end_u); ++u) {
        const std::size_t i = std::size_t(v) * camera_.width + u;
        if (!(depth[i] > 0) || (!shown_objects.empty() && shown_objects[i] != 0)) continue;
        const Vector ray = ray_of(camera_, float(u), float(v));
        if (!box_.inside(ray).ends_before(depth[i])) continue;
        if (!is_empty)
          is_empty = box_.is_empty_along(
              ray_of(camera_, float(from_u) + middle, float(from_v) + middle), rays_);
        is_world[i] = *is_empty && (is_world[i] || ended(ray, depth[i], cached));
        if (!is_world[i]) depth[i] = std::numeric_limits<float>::quiet_NaN();
      }
  }

 private:
  /// What the rays said of a pixel. Its neighbours at the same depth are seen by the same rays.
  struct CachedAnswer {
    float depth = std::numeric_limits<float>::infinity();
    bool ended = false;
  };

  bool ended(const Vector& ray, float depth, CachedAnswer& cached) const {
    if (!(std::fabs(depth - cached.depth) < kSurfaceMargin)) {
      const QuadrantRays corners =
          rays_.around({ray * depth, Kind::kStatic, Vector::Zero(), box_.within()});
      cached = {depth, count(corners, {Verdict::kEnded}) >= kMinEnded};
    }
    return cached.ended;
  }

  const Camera& camera_;
  const SeenBox& box_;
  const ShutterRays& rays_;
  int cell_;
};

}  // namespace

void mask_unobserved_background(const Camera& camera, const MeshScene& scene,
                                const std::vector<std::uint16_t>& shown_objects,
                                std::vector<float>& depth, int threads) {
  if (scene.boxes.empty()) return;
  const ShutterRays rays(scene.shutter_rays);
  const int cell = cell_of(camera, scene.shutter_rays);
  std::vector<std::uint8_t> is_world(depth.size(), 0);
  for (const ObjectBox& placed : scene.boxes) {
    const SeenBox box(camera, placed);
    const PixelBounds& bounds = box.bounds();
    if (bounds.empty()) continue;
    const BoxBackground pixels(camera, box, rays, cell);
    const auto rows = std::size_t(bounds.end_v - bounds.begin_v + cell - 1) / cell;
    parallel_for(rows, 4, threads, [&](std::size_t begin, std::size_t end) {
      for (int row = int(begin); row < int(end); ++row)
        for (int u = bounds.begin_u; u < bounds.end_u; u += cell)
          pixels.empty(u, bounds.begin_v + row * cell, shown_objects, is_world, depth);
    });
  }
}

}  // namespace docdepth
