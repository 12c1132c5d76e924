#include "docdepth/dynamics/surface_image.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "docdepth/dynamics/window.hpp"
#include "docdepth/geometry/dispatch.hpp"
#include "docdepth/surface/directions.hpp"

namespace docdepth {
namespace {

constexpr float kEmpty = std::numeric_limits<float>::infinity();

/// What the triangle says, and whether a return nearby may still object: 1 where it may.
struct AskTriangles {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* x, const float* y, const float* z,
                                  const float* range, const float* a, const float* b,
                                  const float* c, const float* distance, SurfaceImageParameters p,
                                  std::int32_t* __restrict is_static,
                                  std::int32_t* __restrict is_dynamic,
                                  std::int32_t* __restrict open) {
    for (std::size_t i = 0; i < count; ++i) {
      const float r = range[i];
      const float depth = (a[i] * x[i] + b[i] * y[i]) + c[i] * z[i];
      const float gap = distance[i] - depth;
      // Choices between numbers, since compilers do not vectorise those between truth values.
      const int level = std::fabs(c[i]) > p.level_cosine ? 1 : 0;
      const float across = level ? p.level.across : p.upright.across;
      const float level_along = p.level.along + p.level.growth * r;
      const float upright_along = p.upright.along + p.upright.growth * r;
      const float along = level ? level_along : upright_along;
      const int on_plane =
          (std::fabs(gap) < across ? 1 : 0) | (r * std::fabs(gap) < along * depth ? 1 : 0);
      const int before_plane = (gap > 0.0f ? 1 : 0) & (depth > 0.0f ? 1 : 0);

      const float to_a = r - a[i], to_b = r - b[i], to_c = r - c[i];
      const int on_corner = (std::fabs(to_a) < p.tolerance ? 1 : 0) |
                            (std::fabs(to_b) < p.tolerance ? 1 : 0) |
                            (std::fabs(to_c) < p.tolerance ? 1 : 0);
      const int before_corners = (to_a < -p.tolerance ? 1 : 0) & (to_b < -p.tolerance ? 1 : 0) &
                                 (to_c < -p.tolerance ? 1 : 0);

      const int plane = distance[i] >= 0.0f ? 1 : 0;
      const int jump = distance[i] == -1.0f ? 1 : 0;
      const int here = (plane & on_plane) | (jump & on_corner);
      is_static[i] = here;
      is_dynamic[i] = (1 - here) & ((plane & before_plane) | (jump & before_corners));
      open[i] = -((1 - here) & (1 - (plane & level)));
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

}  // namespace

SurfaceImage::SurfaceImage(const Points& points, const SurfaceParameters& surface,
                           const SurfaceImageParameters& parameters)
    : parameters_(parameters), canvas_(parameters.resolution, parameters.window / 2) {
  if (parameters.window < 1 || parameters.window % 2 == 0)
    throw std::invalid_argument("the window must be an odd number of pixels");
  const Returns returns(points);
  range_ = canvas_.nearest_ranges(returns, canvas_.fit(returns));
  draw(points, build_surface(points, surface));

  std::vector<float> seen(range_);
  for (float& range : seen) range = range == kEmpty ? 0.0f : range;
  const auto nearest = window_minimum(range_, canvas_.stride(), canvas_.half());
  const auto farthest = window_maximum(seen, canvas_.stride(), canvas_.half());
  windows_.resize(range_.size());
  for (std::size_t i = 0; i < windows_.size(); ++i) windows_[i] = {nearest[i], farthest[i]};
}

/// The plane through three returns, in double precision and a fixed order of operations. Corners
/// that are in line have no plane and count as a jump.
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
  const double length = std::sqrt((n[0] * n[0] + n[1] * n[1]) + n[2] * n[2]);
  if (cut || !(length > 0.0)) {
    Seen jump{{}, kJump};
    for (int i = 0; i < 3; ++i)
      jump.values[i] =
          range_of(points(corners[i], 0), points(corners[i], 1), points(corners[i], 2));
    return jump;
  }
  const double distance = ((n[0] * p[0][0] + n[1] * p[0][1]) + n[2] * p[0][2]) / length;
  const double scale = distance < 0.0 ? -length : length;  // the normal points away from the sensor
  return {{static_cast<float>(n[0] / scale), static_cast<float>(n[1] / scale),
           static_cast<float>(n[2] / scale)},
          static_cast<float>(std::fabs(distance))};
}

void SurfaceImage::draw(const Points& points, const Surface& surface) {
  seen_.assign(canvas_.size(), Seen{{}, kNothing});
  const std::int64_t columns = canvas_.grid().columns();
  for (std::size_t t = 0; t < surface.triangles.size(); ++t) {
    std::array<Corner, 3> corners;
    for (int i = 0; i < 3; ++i) {
      const auto n = surface.triangles[t][i];
      const Direction d = direction_of(points(n, 0), points(n, 1), points(n, 2));
      corners[i] = {(kTurn / 2 - d.azimuth) * columns, (kTurn / 4 - d.elevation) * columns};
      // The shorter way around from the first corner.
      if (corners[i][0] - corners[0][0] > kTurn / 2 * columns) corners[i][0] -= kTurn * columns;
      if (corners[0][0] - corners[i][0] > kTurn / 2 * columns) corners[i][0] += kTurn * columns;
    }
    const Seen seen = triangle(points, surface.triangles[t], surface.cut[t]);
    for_each_pixel(corners, [&](std::int64_t column, std::int64_t row) {
      column = (column + columns) % columns;
      const std::size_t pixel = (row - canvas_.top()) * canvas_.stride() + column + canvas_.half();
      if (seen_[pixel].distance == kNothing) seen_[pixel] = seen;
    });
  }
}

void SurfaceImage::vote(const QueryPoints& points, std::uint16_t* statics,
                        std::uint16_t* dynamics) const {
  constexpr std::size_t kMax = QueryPoints::kMax;
  std::int32_t pixel[kMax];
  canvas_.find(points, pixel);
  float a[kMax], b[kMax], c[kMax], distance[kMax];
  for (std::size_t i = 0; i < points.size; ++i) {
    const Seen& seen = seen_[pixel[i]];
    a[i] = seen.values[0];
    b[i] = seen.values[1];
    c[i] = seen.values[2];
    distance[i] = seen.distance;
  }
  std::int32_t is_static[kMax], is_dynamic[kMax], open[kMax];
  dispatch<AskTriangles>(points.size, points.x, points.y, points.z, points.range, a, b, c, distance,
                         parameters_, is_static, is_dynamic, open);
  for_each_flagged(points.size, open, [&](std::size_t i) {
    if (!near_return(points.range[i], pixel[i])) return;
    is_static[i] = 1;
    is_dynamic[i] = 0;
  });
  for (std::size_t i = 0; i < points.size; ++i) {
    statics[i] += is_static[i];
    dynamics[i] += is_dynamic[i];
  }
}

/// Is there a return within the tolerance in the window?
bool SurfaceImage::near_return(float range, std::size_t pixel) const {
  const float tolerance = parameters_.tolerance;
  const Window window = windows_[pixel];
  if (range - window.nearest <= -tolerance || range - window.farthest >= tolerance) return false;
  const int half = canvas_.half();
  for (int row = -half; row <= half; ++row) {
    const float* image = &range_[pixel + row * static_cast<std::ptrdiff_t>(canvas_.stride())];
    for (int column = -half; column <= half; ++column)
      if (std::fabs(range - image[column]) < tolerance) return true;
  }
  return false;
}

}  // namespace docdepth
