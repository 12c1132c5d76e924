#include "docdepth/mesh/scan_mesh.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "docdepth/geometry/simd.hpp"
#include "docdepth/mesh/delaunay.hpp"

namespace docdepth {
namespace {

struct Ray {
  float x, y, z;  ///< unit vector
  float range;    ///< 0 if the point is no return
};

struct FindRays {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* points, std::size_t stride,
                                  Ray* __restrict rays) {
    for (std::size_t i = 0; i < count; ++i) {
      const float* p = points + stride * i;
      const float x = p[0], y = p[1], z = p[2];
      const float range = std::sqrt((x * x + y * y) + z * z);
      const bool usable = range > 0.0f && range < kMaxRange;  // false for NaN
      rays[i].x = usable ? x / range : 0.0f;
      rays[i].y = usable ? y / range : 0.0f;
      rays[i].z = usable ? z / range : 0.0f;
      rays[i].range = usable ? range : 0.0f;
    }
  }
};

DOCDEPTH_KERNEL Vectors operator-(const Vectors& a, const Vectors& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
DOCDEPTH_KERNEL Vectors cross(const Vectors& a, const Vectors& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
DOCDEPTH_KERNEL Floats dot(const Vectors& a, const Vectors& b) {
  return a.x * b.x + (a.y * b.y + a.z * b.z);
}
DOCDEPTH_KERNEL Floats length(const Vectors& v) {
  return root(dot(v, v));
}

/// One corner of each of eight triangles.
struct Corners {
  float x[kLanes] = {}, y[kLanes] = {}, z[kLanes] = {}, range[kLanes] = {};

  DOCDEPTH_KERNEL void set(std::size_t lane, const Ray& ray) {
    x[lane] = ray.x;
    y[lane] = ray.y;
    z[lane] = ray.z;
    range[lane] = ray.range;
  }
  DOCDEPTH_KERNEL void set(std::size_t lane, const float* point) {
    x[lane] = point[0];
    y[lane] = point[1];
    z[lane] = point[2];
  }
  DOCDEPTH_KERNEL Vectors vectors() const { return {load(x), load(y), load(z)}; }
};

/// One side of each of eight triangles.
struct Side {
  Floats gap_squared;  ///< squared chord between the directions, close to the angle
  Floats change;       ///< change of range [m]
  Floats steepness;    ///< change over the distance across the ray; 0 within the noise

  DOCDEPTH_KERNEL Side(const Corners& a, const Corners& b, float noise) {
    const Vectors d = a.vectors() - b.vectors();
    const Floats range_a = load(a.range), range_b = load(b.range);
    gap_squared = (d.x * d.x + d.y * d.y) + d.z * d.z;
    change = absolute(range_a - range_b);
    steepness = change / ((range_a < range_b ? range_a : range_b) * root(gap_squared));
    steepness = change <= noise ? Floats{} : steepness;
  }
};

DOCDEPTH_KERNEL Floats largest(const Floats& a, const Floats& b, const Floats& c) {
  const Floats larger = a > b ? a : b;
  return larger > c ? larger : c;
}

/// A triangle so many times as wide as rays are apart spans rays that did not return.
constexpr float kGapSpacings = 2;
/// Every so many triangles tell how far rays are apart.
constexpr std::size_t kSpacingStep = 16;

/// How far neighbouring rays of a sweep are apart: the median of the longest sides of triangles,
/// as the diagonals of a grid of rings and columns [rad].
float ray_spacing(const Triangulation& triangulation, const std::vector<Ray>& rays) {
  std::vector<float> longest;
  const auto gap_squared = [&](std::uint32_t i, std::uint32_t j) {
    const float x = rays[i].x - rays[j].x, y = rays[i].y - rays[j].y, z = rays[i].z - rays[j].z;
    return (x * x + y * y) + z * z;
  };
  for (std::size_t t = 0; t < triangulation.size(); t += kSpacingStep) {
    const auto& [i, j, k] = triangulation[t].corners;
    longest.push_back(std::max({gap_squared(i, j), gap_squared(j, k), gap_squared(k, i)}));
  }
  if (longest.empty()) return 0;
  const auto middle = longest.begin() + std::ptrdiff_t(longest.size() / 2);
  std::nth_element(longest.begin(), middle, longest.end());
  return std::sqrt(*middle);
}

struct Shape {
  bool is_wide, is_steep;
  std::uint8_t flattest;  ///< side with the least change of range
};

struct FindShapes {
  /// @param spacing  of the rays of the sweep [rad]
  DOCDEPTH_KERNEL static void run(std::size_t count, const Triangle* triangles, const Ray* rays,
                                  const MeshParameters& parameters, float spacing, Shape* shapes) {
    const float gap = kGapSpacings * spacing;
    for (std::size_t first = 0; first < count; first += kLanes) {
      const std::size_t some = std::min(count - first, std::size_t{kLanes});
      Corners a, b, c;
      for (std::size_t lane = 0; lane < some; ++lane) {
        const auto& [i, j, k] = triangles[first + lane].corners;
        a.set(lane, rays[i]);
        b.set(lane, rays[j]);
        c.set(lane, rays[k]);
      }
      const float noise = parameters.noise;
      const Side ab(a, b, noise), bc(b, c, noise), ca(c, a, noise);
      const Floats widest = largest(ab.gap_squared, bc.gap_squared, ca.gap_squared);
      const Ints is_wide = widest > parameters.max_gap * parameters.max_gap;
      const Floats steepest = largest(ab.steepness, bc.steepness, ca.steepness);
      const Ints is_steep = (steepest > parameters.jump_ratio) |
                            ((steepest > parameters.gap_jump_ratio) & (widest > gap * gap));
      const Floats less = bc.change < ab.change ? bc.change : ab.change;
      const Ints flatter = -(bc.change < ab.change);
      const Ints flattest = ca.change < less ? Ints{} + 2 : flatter;
      for (std::size_t lane = 0; lane < some; ++lane)
        shapes[first + lane] = {is_wide[lane] != 0, is_steep[lane] != 0,
                                static_cast<std::uint8_t>(flattest[lane])};
    }
  }
};

/// Whether d continues the plane of triangle (a, b, c) beyond a-b. Each far corner is held against
/// the plane of the other triangle, since a small triangle always fits a large one. They must lie
/// on two sides of a-b: a thin object before a wall makes a fold.
DOCDEPTH_KERNEL Ints is_one_plane(const Vectors& a, const Vectors& b, const Vectors& c,
                                  const Vectors& d, float tolerance) {
  const Vectors side = b - a, n = cross(side, c - a), m = cross(side, d - a);
  const Floats length_n = length(n), length_m = length(m);
  const Floats over_n = absolute(dot(n, d - a)), over_m = absolute(dot(m, c - a));
  return (dot(n, m) < 0.0f) & (absolute(dot(n, a)) > kMinIncidenceSine * length_n * length(a)) &
         (over_n <= tolerance * length_n) & (over_m <= tolerance * length_m);
}

/// Two neighbouring triangles: their common edge a-b, the far corner of each.
struct Fold {
  std::uint32_t a, b, c, d;
};

struct TestFolds {
  DOCDEPTH_KERNEL static void run(std::size_t count, const Fold* folds, const float* points,
                                  std::size_t stride, float tolerance, std::uint8_t* is_flat) {
    for (std::size_t first = 0; first < count; first += kLanes) {
      const std::size_t some = std::min(count - first, std::size_t{kLanes});
      Corners a, b, c, d;
      for (std::size_t lane = 0; lane < some; ++lane) {
        const Fold& fold = folds[first + lane];
        a.set(lane, points + stride * fold.a);
        b.set(lane, points + stride * fold.b);
        c.set(lane, points + stride * fold.c);
        d.set(lane, points + stride * fold.d);
      }
      const Ints flat = is_one_plane(a.vectors(), b.vectors(), c.vectors(), d.vectors(), tolerance);
      for (std::size_t lane = 0; lane < some; ++lane) is_flat[first + lane] = flat[lane] != 0;
    }
  }
};

/// Tests in batches whether triangles continue the plane of a neighbour.
class Folds {
 public:
  explicit Folds(const Triangulation& triangulation) : triangulation_(triangulation) {}

  /// Test triangle t against the neighbour beyond its side i.
  void add(std::uint32_t t, std::uint32_t i) {
    const std::uint32_t neighbour = triangulation_[t].across[i];
    if (neighbour == kNone) return;
    const auto &corners = triangulation_[t].corners, &other = triangulation_[neighbour].corners;
    const std::uint32_t a = corners[i], b = corners[(i + 1) % 3], c = corners[(i + 2) % 3];
    folds_.push_back({a, b, c, other[0] ^ other[1] ^ other[2] ^ a ^ b});
    triangles_.push_back(t);
  }

  /// Clear the marks of the triangles that continue the plane of a neighbour they were tested with.
  void clear_flat(const Points& points, float tolerance, std::vector<std::uint8_t>& marks) {
    std::vector<std::uint8_t> is_flat(folds_.size());
    dispatch<TestFolds>(folds_.size(), folds_.data(), points.data(),
                        static_cast<std::size_t>(points.outerStride()), tolerance, is_flat.data());
    for (std::size_t k = 0; k < folds_.size(); ++k)
      if (is_flat[k]) marks[triangles_[k]] = 0;
    folds_.clear();
    triangles_.clear();
  }

 private:
  const Triangulation& triangulation_;
  std::vector<Fold> folds_;
  std::vector<std::uint32_t> triangles_;
};

/// Which triangles span a depth jump. Each steep one is first tested with its neighbour beyond the
/// side of the least change of range (along a ring). Then, for the last ring of the ground or of a
/// wall, it is tested with its other neighbours that are continuous.
std::vector<std::uint8_t> find_discontinuities(const Points& points,
                                               const Triangulation& triangulation,
                                               const std::vector<Shape>& shapes, float flatness) {
  const auto count = static_cast<std::uint32_t>(triangulation.size());
  std::vector<std::uint8_t> jump(count);
  Folds folds(triangulation);
  for (std::uint32_t t = 0; t < count; ++t) {
    jump[t] = shapes[t].is_steep;
    if (jump[t]) folds.add(t, shapes[t].flattest);
  }
  folds.clear_flat(points, flatness, jump);
  for (std::uint32_t t = 0; t < count; ++t)
    for (std::uint32_t i = 0; jump[t] && i < 3; ++i)
      if (triangulation[t].across[i] != kNone && !jump[triangulation[t].across[i]]) folds.add(t, i);
  folds.clear_flat(points, flatness, jump);
  return jump;
}

}  // namespace

ScanMesh build_scan_mesh(const Points& points, const MeshParameters& parameters) {
  std::vector<Ray> rays(points.rows());
  dispatch<FindRays>(rays.size(), points.data(), static_cast<std::size_t>(points.outerStride()),
                     rays.data());
  std::vector<std::uint32_t> usable;
  usable.reserve(rays.size());
  for (std::uint32_t i = 0; i < rays.size(); ++i)
    if (rays[i].range > 0.0f) usable.push_back(i);
  const Triangulation triangulation = triangulate(directions_of(points), usable);
  std::vector<Shape> shapes(triangulation.size());
  dispatch<FindShapes>(shapes.size(), triangulation.data(), rays.data(), parameters,
                       ray_spacing(triangulation, rays), shapes.data());
  ScanMesh mesh;
  mesh.points = rays.size();
  mesh.discontinuity = find_discontinuities(points, triangulation, shapes, parameters.flatness);
  mesh.triangles.reserve(shapes.size());
  std::vector<std::uint8_t> used(rays.size(), 0);
  std::size_t kept = 0;
  for (std::size_t t = 0; t < shapes.size(); ++t) {
    if (shapes[t].is_wide) continue;
    const auto& corners = triangulation[t].corners;
    mesh.triangles.push_back(corners);
    const std::uint8_t jump = mesh.discontinuity[t];
    mesh.discontinuity[kept++] = jump;  // wide triangles are left out, in place
    if (!jump)
      for (const auto corner : corners) used[corner] = 1;
  }
  mesh.discontinuity.resize(kept);
  for (const auto i : usable)
    if (!used[i]) mesh.isolated.push_back(i);
  return mesh;
}

}  // namespace docdepth
