#include "docdepth/surface/surface.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/surface/delaunay.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// Largest range that squares without overflow; what lies beyond is no measurement.
constexpr float kFarthest = 1e6f;

struct Ray {
  Vector toward;  // unit
  float range;
};

/// Rays of all points, range 0 for those that cannot be used.
std::vector<Ray> rays_of(const Points& points) {
  std::vector<Ray> rays(points.rows());
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const float x = points(i, 0), y = points(i, 1), z = points(i, 2);
    const float range = std::sqrt((x * x + y * y) + z * z);
    const bool usable = range > 0.0f && range < kFarthest;  // false for NaN
    rays[i].range = usable ? range : 0.0f;
    rays[i].toward = usable ? Vector(x / range, y / range, z / range) : Vector(0, 0, 0);
  }
  return rays;
}

/// Squared chord between two unit vectors: near the squared angle for what a triangle spans.
float gap_squared(const Ray& a, const Ray& b) {
  const Vector d = a.toward - b.toward;
  return (d.x() * d.x() + d.y() * d.y()) + d.z() * d.z();
}

/// How many times more the range changes along an edge than the distance across; 0 within noise.
float steepness(const Ray& a, const Ray& b, float gap, float noise) {
  const float change = std::fabs(a.range - b.range);
  return change <= noise ? 0.0f : change / (std::min(a.range, b.range) * gap);
}

/// Sine of the angle between a line of sight and the flattest plane that is still believed: the
/// road 80 m ahead. What is flatter joins the edge of an object to what lies behind it.
constexpr float kGrazing = 0.02f;

/// Does d continue the plane of the triangle (a, b, c) beyond a-b? Each far corner is asked about
/// the other triangle's plane, since a small triangle always fits a large one, and they must lie on
/// two sides of a-b: a thin thing and the wall to its left and right is a fold.
bool one_plane(const Vector& a, const Vector& b, const Vector& c, const Vector& d,
               float tolerance) {
  const Vector side = b - a;
  const Vector n = side.cross(c - a), m = side.cross(d - a);
  const float over_n = std::fabs(n.dot(d - a)), over_m = std::fabs(m.dot(c - a));
  return n.dot(m) < 0 && std::fabs(n.dot(a)) > kGrazing * n.norm() * a.norm() &&
         over_n <= tolerance * n.norm() && over_m <= tolerance * m.norm();
}

/// What the sides of a triangle tell.
struct Sides {
  float widest_squared = 0.0f;
  float steepest = 0.0f;
  int flattest = 0;  // side with the least change of range
};

Sides sides_of(const std::array<std::uint32_t, 3>& corners, const std::vector<Ray>& rays,
               float noise) {
  Sides sides;
  float least = INFINITY;
  for (int i = 0; i < 3; ++i) {
    const Ray &a = rays[corners[i]], &b = rays[corners[(i + 1) % 3]];
    const float squared = gap_squared(a, b);
    const float change = std::fabs(a.range - b.range);
    sides.widest_squared = std::max(sides.widest_squared, squared);
    sides.steepest = std::max(sides.steepest, steepness(a, b, std::sqrt(squared), noise));
    if (change < least) {
      least = change;
      sides.flattest = i;
    }
  }
  return sides;
}

/// Does triangle t go on the plane of its neighbour beyond side i?
bool goes_on(const Points& points, const Triangulation& mesh, std::size_t t, int i,
             float tolerance) {
  const std::uint32_t neighbour = mesh.across[t][i];
  if (neighbour == kNone) return false;
  const auto &corners = mesh.corners[t], &other = mesh.corners[neighbour];
  const std::uint32_t a = corners[i], b = corners[(i + 1) % 3], c = corners[(i + 2) % 3];
  const std::uint32_t d = other[0] ^ other[1] ^ other[2] ^ a ^ b;  // the corner off the side
  const auto at = [&](std::uint32_t n) -> Vector { return points.row(n).transpose(); };
  return one_plane(at(a), at(b), at(c), at(d), tolerance);
}

/// Which triangles span a depth jump. First each steep one is held against its neighbour beyond the
/// side that changes range the least (along a ring); then, for the last ring of a ground or wall,
/// against its other neighbours that are whole.
std::vector<std::uint8_t> cuts(const Points& points, const Triangulation& mesh,
                               const std::vector<Sides>& sides,
                               const SurfaceParameters& parameters) {
  const std::size_t count = mesh.corners.size();
  std::vector<std::uint8_t> cut(count);
  for (std::size_t t = 0; t < count; ++t)
    cut[t] = sides[t].steepest > parameters.jump_ratio &&
             !goes_on(points, mesh, t, sides[t].flattest, parameters.flatness);
  const std::vector<std::uint8_t> first = cut;
  for (std::size_t t = 0; t < count; ++t)
    for (int i = 0; cut[t] && i < 3; ++i)
      if (mesh.across[t][i] != kNone && !first[mesh.across[t][i]])
        cut[t] = !goes_on(points, mesh, t, i, parameters.flatness);
  return cut;
}

}  // namespace

Surface build_surface(const Points& points, const SurfaceParameters& parameters) {
  const std::vector<Ray> rays = rays_of(points);
  std::vector<Direction> directions(rays.size());
  std::vector<std::uint32_t> usable;
  usable.reserve(rays.size());
  for (std::uint32_t i = 0; i < rays.size(); ++i) {
    if (rays[i].range == 0.0f) continue;
    directions[i] = direction_of(points(i, 0), points(i, 1), points(i, 2));
    usable.push_back(i);
  }
  const Triangulation mesh = triangulate(directions, usable);
  std::vector<Sides> sides;
  sides.reserve(mesh.corners.size());
  for (const auto& corners : mesh.corners)
    sides.push_back(sides_of(corners, rays, parameters.noise));
  const std::vector<std::uint8_t> cut = cuts(points, mesh, sides, parameters);

  Surface surface;
  surface.points = rays.size();
  surface.triangles.reserve(mesh.corners.size());
  surface.cut.reserve(mesh.corners.size());
  std::vector<std::uint8_t> used(rays.size(), 0);
  for (std::size_t t = 0; t < mesh.corners.size(); ++t) {
    if (sides[t].widest_squared > parameters.max_gap * parameters.max_gap) continue;
    surface.triangles.push_back(mesh.corners[t]);
    surface.cut.push_back(cut[t]);
    if (!cut[t])
      for (const auto corner : mesh.corners[t]) used[corner] = 1;
  }
  for (const auto i : usable)
    if (!used[i]) surface.loose.push_back(i);
  return surface;
}

}  // namespace docdepth
