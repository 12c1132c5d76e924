#include "docdepth/voting/mesh_image.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "docdepth/geometry/simd.hpp"
#include "docdepth/mesh/directions.hpp"
#include "docdepth/voting/padded_range_image.hpp"

namespace docdepth {
namespace {

/// A plane nearer to the sensor has no usable normal form [m].
constexpr double kMinPlaneDistance = 0.01;
// Pixel::bits, from the highest bit: whether its triangle is a discontinuity (1); the nearest and
// the farthest return of its window (12 and 12, the upper bits of floats after the sign, rounded
// outwards); whether its triangle is ground (1); distance from its centre to the nearest corner (6,
// in kSteps to a pixel).
constexpr std::uint32_t kJump = 0x80000000, kRange = 0x7ff80000, kOnGround = 0x40,
                        kMostSteps = 0x3f;
constexpr int kSteps = 8;

/// Votes by the triangles of pixels. `open` is negative where a return of the window may overrule.
/// @param seen  the pixels, four values each
struct VoteByTriangles {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* x, const float* y, const float* z,
                                  const float* range, const float* seen, float step,
                                  MeshImageParameters p, std::uint16_t* __restrict statics,
                                  std::uint16_t* __restrict dynamics,
                                  std::int32_t* __restrict open) {
    for (std::size_t i = 0; i < count; ++i) {
      const float a = seen[4 * i], b = seen[4 * i + 1], c = seen[4 * i + 2];
      const std::uint32_t bits = std::bit_cast<std::uint32_t>(seen[4 * i + 3]);
      const float nearest = std::bit_cast<float>(bits & kRange),
                  farthest = std::bit_cast<float>(bits << 12 & kRange);
      const float angle = step * static_cast<float>(static_cast<std::int32_t>(bits & kMostSteps));
      const int jump = static_cast<int>(bits >> 31);

      const float r = range[i];
      const float depth = (a * x[i] + b * y[i]) + c * z[i];  // 1 on the plane, less before it
      const float distance = 1.0f / std::sqrt((a * a + b * b) + c * c);
      const float before = 1.0f - depth;
      // Choices between integers, since compilers do not vectorise those between booleans.
      const float rise = (a * p.up[0] + b * p.up[1]) + c * p.up[2];
      const int level = std::fabs(rise) * distance > p.level_cosine ? 1 : 0;
      const float level_normal = bits & kOnGround ? p.ground_tolerance : p.level.normal_tolerance;
      const float normal = level ? level_normal : p.upright.normal_tolerance;
      const float level_radial = p.level.radial_tolerance + p.level.radial_growth * r;
      const float upright_radial = p.upright.radial_tolerance + p.upright.radial_growth * r;
      const float radial = level ? level_radial : upright_radial;
      const int on_plane = (std::fabs(before) * distance < normal ? 1 : 0) |
                           (r * std::fabs(before) < radial * depth ? 1 : 0);
      const int before_plane = (before > 0.0f ? 1 : 0) & (depth > 0.0f ? 1 : 0);

      const float to_a = r - a, to_b = r - b, to_c = r - c;
      const int on_corner = (std::fabs(to_a) < p.tolerance ? 1 : 0) |
                            (std::fabs(to_b) < p.tolerance ? 1 : 0) |
                            (std::fabs(to_c) < p.tolerance ? 1 : 0);
      const int before_corners = (to_a < -p.tolerance ? 1 : 0) & (to_b < -p.tolerance ? 1 : 0) &
                                 (to_c < -p.tolerance ? 1 : 0);

      const int on_it = jump ? on_corner : on_plane;
      const int before_it = jump ? before_corners : before_plane;
      const int flat = jump ? 0 : level;
      const int returns =
          (r - nearest > -p.tolerance ? 1 : 0) & (r - farthest < p.tolerance ? 1 : 0);
      const int in_sight = r * angle < p.max_ray_distance ? 1 : 0;
      const int is_static = in_sight & on_it;
      const int is_dynamic = in_sight & (1 - on_it) & before_it;
      statics[i] = static_cast<std::uint16_t>(statics[i] + is_static);
      dynamics[i] = static_cast<std::uint16_t>(dynamics[i] + is_dynamic);
      // -2: the window may overrule a dynamic vote; -1: no vote.
      open[i] = ((1 - is_static) & (1 - flat) & returns) ? -1 - is_dynamic : 0;
    }
  }
};

/// Makes open points static that have a return within the tolerance in their window.
struct VoteByWindows {
  DOCDEPTH_KERNEL static void run(std::size_t count, const std::int32_t* points, const float* range,
                                  const std::int32_t* pixel, const std::int32_t* open,
                                  const float* corner, std::size_t stride, int window,
                                  float tolerance, std::uint16_t* __restrict statics,
                                  std::uint16_t* __restrict dynamics) {
    Ints lanes;
    for (int lane = 0; lane < kLanes; ++lane) lanes[lane] = lane;
    for (std::size_t k = 0; k < count; ++k) {
      const std::int32_t i = points[k];
      const float* row = corner + pixel[i];
      Ints on{};
      for (int left = 0; left < window; left += kLanes) {
        Ints here{};
        for (int r = 0; r < window; ++r) {
          const Floats difference = range[i] - load(row + r * stride + left);
          here |= (difference > -tolerance) & (difference < tolerance);
        }
        on |= here & (left + lanes < window);
      }
      const int met = any(on) ? -1 : 0;
      statics[i] += met & 1;
      dynamics[i] -= met & (-1 - open[i]);
    }
  }
};

using Corner = std::array<std::int64_t, 2>;

/// First pixel k whose centre, (2 k + 1) kTurn / 2, is not below a coordinate.
std::int64_t first_pixel(std::int64_t coordinate) {
  static_assert(kTurn == 1 << 16);
  return (coordinate + kTurn / 2 - 1) >> 16;
}

/// Call body(column, row) for the pixels whose centres lie in a triangle or on its border.
/// Coordinates are exact integers: pixels times kTurn.
template <class Body>
void for_each_pixel(const std::array<Corner, 3>& corners, const Body& body) {
  const auto span = [&](int axis) {
    const auto [low, high] = std::minmax({corners[0][axis], corners[1][axis], corners[2][axis]});
    return std::array<std::int64_t, 2>{first_pixel(low), first_pixel(high + 1)};
  };
  const auto columns = span(0), rows = span(1);
  if (columns[0] == columns[1] || rows[0] == rows[1]) return;
  // Twice the signed areas of the first centre with each side, and their steps from pixel to pixel.
  std::int64_t area[3], right[3], down[3];
  for (int i = 0; i < 3; ++i) {
    const Corner &a = corners[i], &b = corners[(i + 1) % 3];
    const std::int64_t x = b[0] - a[0], y = b[1] - a[1];
    area[i] =
        x * (rows[0] * kTurn + kTurn / 2 - a[1]) - y * (columns[0] * kTurn + kTurn / 2 - a[0]);
    right[i] = -y * kTurn;
    down[i] = x * kTurn;
  }
  for (std::int64_t row = rows[0]; row < rows[1]; ++row) {
    std::int64_t at[3] = {area[0], area[1], area[2]};
    for (std::int64_t column = columns[0]; column < columns[1]; ++column) {
      if ((at[0] | at[1] | at[2]) >= 0) body(column, row);
      for (int i = 0; i < 3; ++i) at[i] += right[i];
    }
    for (int i = 0; i < 3; ++i) area[i] += down[i];
  }
}

/// Distance from the centre of a pixel to the nearest corner, in kSteps to a pixel.
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

MeshImage::MeshImage(const Points& points, const bool* ground, const ScanMesh& mesh,
                     const MeshImageParameters& parameters)
    : parameters_(parameters), padded_(parameters.resolution, parameters.window / 2) {
  if (parameters.window < 1 || parameters.window % 2 == 0)
    throw std::invalid_argument("the window must be an odd number of pixels");
  const Returns returns(points);
  range_ = padded_.nearest_ranges(returns, padded_.fit(returns));
  draw(points, ground, mesh);
  summarize_windows();
  range_.resize(padded_.size() + kLanes, kEmpty);  // read by vectors, never used
}

void MeshImage::summarize_windows() {
  std::vector<float> seen(range_);
  for (float& range : seen) range = range == kEmpty ? 0.0f : range;
  const auto nearest = padded_.window_minimum(range_);
  const auto farthest = padded_.window_maximum(seen);
  for (std::size_t i = 0; i < pixels_.size(); ++i)
    pixels_[i].bits |= (std::bit_cast<std::uint32_t>(nearest[i]) & kRange) |
                       ((std::bit_cast<std::uint32_t>(farthest[i]) + 0x7ffff) & kRange) >> 12;
}

/// The plane through three returns, in double precision and a fixed order of operations. Corners in
/// line with each other, or a plane through the sensor, count as a discontinuity.
MeshImage::Pixel MeshImage::make_pixel(const Points& points, const bool* ground,
                                       const std::array<std::uint32_t, 3>& corners,
                                       bool discontinuity) const {
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
  if (discontinuity || !(std::fabs(offset) > kMinPlaneDistance * length)) {
    Pixel jump{{}, kJump};
    for (int i = 0; i < 3; ++i)
      jump.values[i] =
          range_of(points(corners[i], 0), points(corners[i], 1), points(corners[i], 2));
    return jump;
  }
  const bool of_ground = ground[corners[0]] && ground[corners[1]] && ground[corners[2]];
  return {{static_cast<float>(n[0] / offset), static_cast<float>(n[1] / offset),
           static_cast<float>(n[2] / offset)},
          of_ground ? kOnGround : 0u};
}

void MeshImage::draw(const Points& points, const bool* ground, const ScanMesh& mesh) {
  pixels_.assign(padded_.size(), Pixel{});
  std::vector<std::uint8_t> drawn(padded_.size());
  const std::int64_t columns = padded_.grid().columns(), turn = kTurn * columns;
  const std::vector<Direction> directions = directions_of(points);
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    std::array<Corner, 3> corners;
    for (int i = 0; i < 3; ++i) {
      const Direction d = directions[mesh.triangles[t][i]];
      corners[i] = {(kTurn / 2 - d.azimuth) * columns, (kTurn / 4 - d.elevation) * columns};
      // The shorter way around the cylinder from the first corner.
      if (corners[i][0] - corners[0][0] > turn / 2) corners[i][0] -= turn;
      if (corners[0][0] - corners[i][0] > turn / 2) corners[i][0] += turn;
    }
    Pixel seen;
    bool is_seen = false;
    for_each_pixel(corners, [&](std::int64_t column, std::int64_t row) {
      const std::int64_t wrapped = column + (column < 0          ? columns
                                             : column >= columns ? -columns
                                                                 : 0);
      const std::size_t pixel = (row - padded_.top()) * padded_.stride() + wrapped + padded_.half();
      // Outside only with a mesh of other points.
      if (pixel >= drawn.size() || drawn[pixel]) return;
      drawn[pixel] = 1;
      if (!is_seen) seen = make_pixel(points, ground, mesh.triangles[t], mesh.discontinuity[t]);
      is_seen = true;
      pixels_[pixel] = seen;
      pixels_[pixel].bits |= steps_to_nearest(corners, column, row);
    });
  }
}

void MeshImage::find(const QueryPoints& points, std::int32_t* pixels) const {
  padded_.find(points, pixels);
  for (std::size_t i = 0; i < points.size; ++i) __builtin_prefetch(&pixels_[pixels[i]]);
}

void MeshImage::vote(const QueryPoints& points, const std::int32_t* pixels, std::uint16_t* statics,
                     std::uint16_t* dynamics) const {
  constexpr std::size_t kMax = QueryPoints::kMax;
  static_assert(sizeof(Pixel) == 4 * sizeof(float));
  float seen[4 * kMax];
  for (std::size_t i = 0; i < points.size; ++i)
    std::memcpy(&seen[4 * i], &pixels_[pixels[i]], sizeof(Pixel));
  const auto step = static_cast<float>(padded_.grid().pixel() / kSteps);
  MeshImageParameters margins = parameters_;
  if (points.ground) margins.level.normal_tolerance = margins.ground_tolerance;
  std::int32_t open[kMax], left[kMax];
  dispatch<VoteByTriangles>(points.size, points.x, points.y, points.z, points.range, seen, step,
                            margins, statics, dynamics, open);
  std::size_t count = 0;
  for (std::size_t i = 0; i < points.size; ++i) {
    left[count] = static_cast<std::int32_t>(i);
    count += open[i] < 0;
  }
  const int window = 2 * padded_.half() + 1;
  const float* corner = padded_.corner(range_);
  for (std::size_t k = 0; k < count; ++k)
    for (int row = 0; row < window; ++row)
      __builtin_prefetch(corner + pixels[left[k]] + row * padded_.stride());
  dispatch<VoteByWindows>(count, left, points.range, pixels, open, corner, padded_.stride(), window,
                          parameters_.tolerance, statics, dynamics);
}

}  // namespace docdepth
