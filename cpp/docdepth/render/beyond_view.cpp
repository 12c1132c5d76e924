#include "docdepth/render/beyond_view.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "docdepth/geometry/rigid.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// Ends that differ by less are one side of an object [m].
constexpr float kSameEnd = 0.1f;
/// Every so many pixels is tried whether a sweep looked there.
constexpr int kSteps = 4;
/// Slower objects have no known heading [m/s].
constexpr float kHeadingSpeed = 1.0f;

/// The pixels of each object that border on others, by its number.
std::vector<std::vector<std::uint32_t>> find_contours(const Camera& camera, std::size_t objects,
                                                      const std::vector<std::uint16_t>& owners) {
  std::vector<std::vector<std::uint32_t>> contours(objects + 1);
  const auto width = std::size_t(camera.width);
  for (std::size_t i = 0; i < owners.size(); ++i) {
    const std::uint16_t owner = owners[i];
    if (owner == 0) continue;
    const std::size_t u = i % width;
    const bool inside = (u == 0 || owners[i - 1] == owner) &&
                        (u + 1 == width || owners[i + 1] == owner) &&
                        (i < width || owners[i - width] == owner) &&
                        (i + width >= owners.size() || owners[i + width] == owner);
    if (!inside) contours[owner].push_back(static_cast<std::uint32_t>(i));
  }
  return contours;
}

/// Continues one object beyond the field of view.
class Continuation {
 public:
  Continuation(const Camera& camera, const PlacedDynamicObject& object,
               const FieldOfView& field_of_view, std::vector<float>& body)
      : camera_(camera),
        extent_(object.extent),
        field_of_view_(field_of_view),
        up_(object.T_camera_sensor[0].linear().col(2).cast<float>()),
        body_(body) {
    for (const Pose& T : object.T_camera_sensor) to_sensors_.emplace_back(T.inverse());
    const float speed = object.velocity.norm();
    if (speed >= kHeadingSpeed) heading_ = object.velocity / speed;
  }

  /// Continue it from its contour, to the sides first and then up and down.
  /// @param depth  of the image
  /// @return the pixels that it may hide; their inverse depth stands in `body`
  std::vector<std::uint32_t> run(const std::vector<std::uint32_t>& contour,
                                 const std::vector<float>& depth) {
    std::vector<Vector> ends;
    for (const std::uint32_t i : contour) ends.push_back(point_at(i, depth[i]));
    const Vector right(1, 0, 0);
    for (const float sign : {-1.0f, 1.0f}) {
      continue_all(ends, sign * right, up_, heading_.isZero(0) ? extent_.x() : extent_.y());
      if (!heading_.isZero(0)) continue_all(ends, sign * heading_, up_, extent_.x());
    }
    const std::vector<std::uint32_t> aside = pixels_;
    for (const std::uint32_t i : aside)
      if (borders(i)) ends.push_back(point_at(i, 1 / body_[i]));
    continue_all(ends, up_, right, extent_.z());
    continue_all(ends, -up_, right, 0);  // the road ends it
    return std::move(pixels_);
  }

 private:
  Vector point_at(std::uint32_t pixel, float z) const {
    const auto u = float(pixel % camera_.width), v = float(pixel / camera_.width);
    return {(u - float(camera_.cx)) / float(camera_.fx) * z,
            (v - float(camera_.cy)) / float(camera_.fy) * z, z};
  }

  /// Whether a marked pixel has one above or below that is not.
  bool borders(std::uint32_t i) const {
    const auto width = static_cast<std::uint32_t>(camera_.width);
    return (i >= width && body_[i - width] == 0) ||
           (i + width < body_.size() && body_[i + width] == 0);
  }

  bool covered(const Vector& point) const {
    return std::any_of(to_sensors_.begin(), to_sensors_.end(),
                       [&](const RigidTransform& T) { return field_of_view_.covers(T * point); });
  }

  /// Whether the view ends on the way from a point. Beside its corners it ends, too, but not
  /// `beside` the way.
  bool is_cut(const Vector& point, const Vector& direction, const Vector& beside) const {
    const float gap = kViewGap * point.norm();
    const Vector out = point + gap * direction;
    return !covered(out) && !covered(out + gap * beside) && !covered(out - gap * beside);
  }

  /// Continue from all ends as far as the object is seen elsewhere, and if the view ends where it
  /// reaches farthest, until it is `extent` long.
  void continue_all(const std::vector<Vector>& ends, const Vector& direction, const Vector& beside,
                    float extent) {
    float most = -std::numeric_limits<float>::infinity(), least = -most;
    for (const Vector& end : ends) {
      most = std::max(most, end.dot(direction));
      least = std::min(least, end.dot(direction));
    }
    const float reach = std::max(extent - (most - least), 0.0f);
    std::vector<const Vector*> cut;
    bool all = true;
    for (const Vector& end : ends) {
      if (is_cut(end, direction, beside))
        cut.push_back(&end);
      else if (end.dot(direction) > most - kSameEnd)
        all = false;
    }
    for (const Vector* end : cut)
      continue_to(*end, direction, most - end->dot(direction) + (all ? reach : 0.0f));
  }

  /// Mark the pixels on the way from a point as far as no sweep looked there.
  void continue_to(const Vector& point, const Vector& direction, float length) {
    const float gap = kViewGap * point.norm();
    const float focal = float(std::max(camera_.fx, camera_.fy));
    Vector at = point;
    int steps = 0;
    for (float gone = 0; gone < length; ++steps) {
      const float step = at.z() / focal;  // a pixel at most
      gone += step, at += step * direction;
      if (!(at.z() > kNear) || (steps % kSteps == 0 && gone > gap && covered(at))) return;
      const float u = at.x() / at.z() * float(camera_.fx) + float(camera_.cx);
      const float v = at.y() / at.z() * float(camera_.fy) + float(camera_.cy);
      if (!(u > -1 && u < float(camera_.width) && v > -1 && v < float(camera_.height))) return;
      const int left = int(std::floor(u)), top = int(std::floor(v));
      for (const int row : {top, top + 1})
        for (const int column : {left, left + 1}) mark(column, row, 1 / at.z());
    }
  }

  void mark(int u, int v, float inverse_depth) {
    if (u < 0 || v < 0 || u >= camera_.width || v >= camera_.height) return;
    const auto i = static_cast<std::uint32_t>(v * camera_.width + u);
    if (body_[i] == 0) pixels_.push_back(i);
    body_[i] = std::max(body_[i], inverse_depth);
  }

  const Camera& camera_;
  const Vector extent_;
  const FieldOfView& field_of_view_;
  std::vector<RigidTransform> to_sensors_;
  const Vector up_;
  Vector heading_{0, 0, 0};
  std::vector<std::uint32_t> pixels_;
  std::vector<float>& body_;
};

}  // namespace

void empty_beyond_view(const Camera& camera, const MeshScene& scene,
                       const std::vector<std::uint16_t>& owners, std::vector<float>& depth) {
  if (!scene.field_of_view) return;
  const auto contours = find_contours(camera, scene.dynamic_objects.size(), owners);
  std::vector<float> body(owners.size(), 0.0f);
  for (std::size_t k = 0; k < scene.dynamic_objects.size(); ++k) {
    const PlacedDynamicObject& object = scene.dynamic_objects[k];
    if (contours[k + 1].empty() || object.T_camera_sensor.empty()) continue;
    for (const std::uint32_t i :
         Continuation(camera, object, *scene.field_of_view, body).run(contours[k + 1], depth)) {
      if (owners[i] == 0 && depth[i] * body[i] > 1)
        depth[i] = std::numeric_limits<float>::quiet_NaN();
      body[i] = 0;
    }
  }
}

}  // namespace docdepth
