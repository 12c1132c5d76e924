#include "docdepth/dynamics/surface_image.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "docdepth/geometry/lanes.hpp"
#include "docdepth/dynamics/window.hpp"
#include "docdepth/geometry/dispatch.hpp"
#include "docdepth/surface/directions.hpp"

namespace docdepth {
namespace {

constexpr float kEmpty = std::numeric_limits<float>::infinity();
constexpr double kNearestPlane = 0.01;  // to the sensor [m]

// What a pixel keeps in 32 bits, from the highest one: whether its triangle is a jump (1); between
// what ranges the returns of its window lie (12 and 12, the highest of two floats after the sign,
// rounded outwards); how far from its centre the nearest corner lies (7, in kSteps a pixel).
constexpr std::uint32_t kJump = 0x80000000, kRange = 0x7ff80000, kMostSteps = 0x7f;
constexpr int kSteps = 16;

float as_float(std::uint32_t bits) {
  float value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

std::uint32_t as_bits(float value) {
  std::uint32_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  return bits;
}

/// What the triangle says, and whether a return nearby may still object: negative where it may.
struct AskTriangles {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* x, const float* y, const float* z,
                                  const float* range, const float* a, const float* b,
                                  const float* c, const std::int32_t* jump, const float* nearest,
                                  const float* farthest, const float* angle,
                                  SurfaceImageParameters p, std::int32_t* __restrict is_static,
                                  std::int32_t* __restrict is_dynamic,
                                  std::int32_t* __restrict open) {
    for (std::size_t i = 0; i < count; ++i) {
      const float r = range[i];
      const float depth = (a[i] * x[i] + b[i] * y[i]) + c[i] * z[i];  // 1 on the plane
      const float distance = 1.0f / std::sqrt((a[i] * a[i] + b[i] * b[i]) + c[i] * c[i]);
      const float before = 1.0f - depth;
      // Choices between numbers, since compilers do not vectorise those between truth values.
      const int level = std::fabs(c[i]) * distance > p.level_cosine ? 1 : 0;
      const float across = level ? p.level.across : p.upright.across;
      const float level_along = p.level.along + p.level.growth * r;
      const float upright_along = p.upright.along + p.upright.growth * r;
      const float along = level ? level_along : upright_along;
      const int on_plane = (std::fabs(before) * distance < across ? 1 : 0) |
                           (r * std::fabs(before) < along * depth ? 1 : 0);
      const int before_plane = (before > 0.0f ? 1 : 0) & (depth > 0.0f ? 1 : 0);

      const float to_a = r - a[i], to_b = r - b[i], to_c = r - c[i];
      const int on_corner = (std::fabs(to_a) < p.tolerance ? 1 : 0) |
                            (std::fabs(to_b) < p.tolerance ? 1 : 0) |
                            (std::fabs(to_c) < p.tolerance ? 1 : 0);
      const int before_corners = (to_a < -p.tolerance ? 1 : 0) & (to_b < -p.tolerance ? 1 : 0) &
                                 (to_c < -p.tolerance ? 1 : 0);

      const int on_it = jump[i] ? on_corner : on_plane;
      const int before_it = jump[i] ? before_corners : before_plane;
      const int flat = jump[i] ? 0 : level;
      const int returns =
          (r - nearest[i] > -p.tolerance ? 1 : 0) & (r - farthest[i] < p.tolerance ? 1 : 0);
      const int in_sight = r * angle[i] < p.beam ? 1 : 0;
      is_static[i] = in_sight & on_it;
      is_dynamic[i] = in_sight & (1 - on_it) & before_it;
      open[i] = -((1 - is_static[i]) & (1 - flat) & returns);
    }
  }
};

/// Make points static that have a return within the tolerance in their window.
struct AskWindows {
  DOCDEPTH_KERNEL static void run(std::size_t count, const std::int32_t* points, const float* range,
                                  const std::int32_t* pixel, const float* corner,
                                  std::size_t stride, int window, float tolerance,
                                  std::int32_t* __restrict is_static,
                                  std::int32_t* __restrict is_dynamic) {
    for (std::size_t k = 0; k < count; ++k) {
      const std::int32_t i = points[k];
      const float* row = corner + pixel[i];
      std::int32_t any = 0;
      for (int left = 0; left < window; left += kLanes) {
        Ints on{};
        for (int r = 0; r < window; ++r) {
          Floats measured;
          std::memcpy(&measured, row + r * stride + left, sizeof measured);
          const Floats difference = range[i] - measured;
          on |= (difference > -tolerance) & (difference < tolerance);
        }
        std::int32_t lanes[kLanes];
        std::memcpy(lanes, &on, sizeof lanes);
        for (int lane = 0; lane < kLanes; ++lane) any |= left + lane < window ? lanes[lane] : 0;
      }
      is_static[i] |= any & 1;
      is_dynamic[i] &= ~any;
    }
  }
};

using Corner = std::array<std::int64_t, 2>;

/// Twice the area of a, b, c.
std::int64_t area(const Corner& a, const Corner& b, const Corner& c) {
  return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

/// First pixel whose centre, (2 k + 1) kTurn / 2, is not below a coordinate.
std::int64_t first_pixel(std::int64_t coordinate) {
  const std::int64_t twice = coordinate - kTurn / 2;
  return twice >= 0 ? (twice + kTurn - 1) / kTurn : -(-twice / kTurn);
}

/// Call body(column, row) for the pixels whose centres lie in a triangle, its border included.
/// Coordinates are exact: pixels times kTurn.
template <class Body>
void for_each_pixel(const std::array<Corner, 3>& corners, const Body& body) {
  const auto span = [&](int axis) {
    const auto [low, high] = std::minmax({corners[0][axis], corners[1][axis], corners[2][axis]});
    return std::array<std::int64_t, 2>{first_pixel(low), first_pixel(high + 1)};
  };
  const auto columns = span(0), rows = span(1);
  for (std::int64_t row = rows[0]; row < rows[1]; ++row) {
    for (std::int64_t column = columns[0]; column < columns[1]; ++column) {
      const Corner centre{column * kTurn + kTurn / 2, row * kTurn + kTurn / 2};
      bool inside = true;
      for (int i = 0; i < 3; ++i) inside &= area(corners[i], corners[(i + 1) % 3], centre) >= 0;
      if (inside) body(column, row);
    }
  }
}

/// From the centre of a pixel to the nearest corner, in kSteps a pixel.
std::uint32_t steps_to_nearest(const std::array<Corner, 3>& corners, std::int64_t column,
                               std::int64_t row) {
  std::int64_t least = std::numeric_limits<std::int64_t>::max();
  for (const Corner& corner : corners) {
    const std::int64_t x = corner[0] - column * kTurn - kTurn / 2;
    const std::int64_t y = corner[1] - row * kTurn - kTurn / 2;
    least = std::min(least, x * x + y * y);
  }
  const double steps = std::sqrt(static_cast<double>(least)) / (kTurn / kSteps);
  return static_cast<std::uint32_t>(std::min(steps, static_cast<double>(kMostSteps)));
}

}  // namespace

SurfaceImage::SurfaceImage(const Points& points, const Surface& surface,
                           const SurfaceImageParameters& parameters)
    : parameters_(parameters), canvas_(parameters.resolution, parameters.window / 2) {
  if (parameters.window < 1 || parameters.window % 2 == 0)
    throw std::invalid_argument("the window must be an odd number of pixels");
  const Returns returns(points);
  range_ = canvas_.nearest_ranges(returns, canvas_.fit(returns));
  draw(points, surface);
  summarize_windows();
  range_.resize(canvas_.size() + kLanes, kEmpty);  // may be read, never looked at
}

void SurfaceImage::summarize_windows() {
  std::vector<float> seen(range_);
  for (float& range : seen) range = range == kEmpty ? 0.0f : range;
  const auto nearest = window_minimum(range_, canvas_.stride(), canvas_.half());
  const auto farthest = window_maximum(seen, canvas_.stride(), canvas_.half());
  for (std::size_t i = 0; i < seen_.size(); ++i)
    seen_[i].bits |=
        (as_bits(nearest[i]) & kRange) | ((as_bits(farthest[i]) + 0x7ffff) & kRange) >> 12;
}

/// The plane through three returns, in double precision and a fixed order of operations. Corners
/// in line, with each other or the sensor, have no plane that it could see and count as a jump.
SurfaceImage::Seen SurfaceImage::triangle(const Points& points,
                                          const std::array<std::uint32_t, 3>& corners,
                                          bool cut) const {
  double p[3][3], u[3], v[3];
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) p[i][k] = points(corners[i], k);
  for (int k = 0; k < 3; ++k) {
    u[k] = p[1][k] - p[0][k];
    v[k] = p[2][k] - p[0][k];
  }
  double n[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
  const double offset = (n[0] * p[0][0] + n[1] * p[0][1]) + n[2] * p[0][2];
  const double length = std::sqrt((n[0] * n[0] + n[1] * n[1]) + n[2] * n[2]);
  if (cut || !(std::fabs(offset) > kNearestPlane * length)) {
    Seen jump{{}, kJump};
    for (int i = 0; i < 3; ++i)
      jump.values[i] =
          range_of(points(corners[i], 0), points(corners[i], 1), points(corners[i], 2));
    return jump;
  }
  return {{static_cast<float>(n[0] / offset), static_cast<float>(n[1] / offset),
           static_cast<float>(n[2] / offset)},
          0};
}

void SurfaceImage::draw(const Points& points, const Surface& surface) {
  seen_.assign(canvas_.size(), Seen{});
  std::vector<std::uint8_t> drawn(canvas_.size());
  const std::int64_t columns = canvas_.grid().columns(), turn = kTurn * columns;
  std::vector<Corner> directions(points.rows());
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const Direction d = direction_of(points(i, 0), points(i, 1), points(i, 2));
    directions[i] = {(kTurn / 2 - d.azimuth) * columns, (kTurn / 4 - d.elevation) * columns};
  }
  for (std::size_t t = 0; t < surface.triangles.size(); ++t) {
    std::array<Corner, 3> corners;
    for (int i = 0; i < 3; ++i) {
      corners[i] = directions[surface.triangles[t][i]];
      // The shorter way around from the first corner.
      if (corners[i][0] - corners[0][0] > turn / 2) corners[i][0] -= turn;
      if (corners[0][0] - corners[i][0] > turn / 2) corners[i][0] += turn;
    }
    for_each_pixel(corners, [&](std::int64_t column, std::int64_t row) {
      const std::int64_t unwrapped = column;
      column += column < 0 ? columns : column >= columns ? -columns : 0;
      const std::size_t pixel = (row - canvas_.top()) * canvas_.stride() + column + canvas_.half();
      if (drawn[pixel]) return;
      drawn[pixel] = 1;
      seen_[pixel] = triangle(points, surface.triangles[t], surface.cut[t]);
      seen_[pixel].bits |= steps_to_nearest(corners, unwrapped, row);
    });
  }
}

void SurfaceImage::vote(const QueryPoints& points, std::uint16_t* statics,
                        std::uint16_t* dynamics) const {
  constexpr std::size_t kMax = QueryPoints::kMax;
  std::int32_t pixel[kMax];
  canvas_.find(points, pixel);
  const auto step = static_cast<float>(canvas_.grid().pixel() / kSteps);
  float a[kMax], b[kMax], c[kMax], nearest[kMax], farthest[kMax], angle[kMax];
  std::int32_t jump[kMax];
  // The images of all key frames together fit into no cache.
  for (std::size_t i = 0; i < points.size; ++i) __builtin_prefetch(&seen_[pixel[i]]);
  for (std::size_t i = 0; i < points.size; ++i) {
    const Seen seen = seen_[pixel[i]];
    a[i] = seen.values[0];
    b[i] = seen.values[1];
    c[i] = seen.values[2];
    jump[i] = (seen.bits & kJump) != 0;
    nearest[i] = as_float(seen.bits & kRange);
    farthest[i] = as_float(seen.bits << 12 & kRange);
    angle[i] = step * static_cast<float>(seen.bits & kMostSteps);
  }
  std::int32_t is_static[kMax], is_dynamic[kMax], open[kMax], left[kMax];
  dispatch<AskTriangles>(points.size, points.x, points.y, points.z, points.range, a, b, c, jump,
                         nearest, farthest, angle, parameters_, is_static, is_dynamic, open);
  std::size_t count = 0;
  for_each_flagged(points.size, open,
                   [&](std::size_t i) { left[count++] = static_cast<std::int32_t>(i); });
  const int half = canvas_.half();
  dispatch<AskWindows>(count, left, points.range, pixel,
                       range_.data() - half * (canvas_.stride() + 1), canvas_.stride(),
                       2 * half + 1, parameters_.tolerance, is_static, is_dynamic);
  for (std::size_t i = 0; i < points.size; ++i) {
    statics[i] += is_static[i];
    dynamics[i] += is_dynamic[i];
  }
}

}  // namespace docdepth
