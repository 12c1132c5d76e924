#include "docdepth/render/edges.hpp"

#include <algorithm>
#include <cmath>

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// What moves goes on this share of the way to the next return, past the middle: rays of other
/// sweeps tell where it ends.
constexpr float kWay = 0.6f;

/// Splits triangles between one corner and the other two.
class Splitter {
 public:
  Splitter(PartedSurface& surface, const std::vector<Vector>& normals)
      : surface_(surface), normals_(normals) {}

  /// @param i corner that is alone; j and k follow it around the triangle
  /// @param alone, together where its part and that of the others go; null keeps none
  void split(std::uint32_t i, std::uint32_t j, std::uint32_t k, Triangles* alone,
             Triangles* together) {
    const Border to_j = border(i, j), to_k = border(i, k);
    if (alone) alone->push_back({i, add(to_j.first), add(to_k.first)});
    if (!together) return;
    const std::uint32_t beside_j = add(to_j.second), beside_k = add(to_k.second);
    together->push_back({beside_j, j, k});
    together->push_back({beside_j, k, beside_k});
  }

 private:
  /// Where the surface of one end of an edge goes over into that of the other: the last place of
  /// each.
  struct Border {
    Vector first, second;
  };

  /// Nearness (1 / range), seen in direction `toward`, of the plane that goes on from point a.
  float plane_nearness(std::uint32_t a, const Vector& toward) const {
    const Vector& normal = normals_[a];
    const float distance = normal.dot(surface_.vertices[a]);
    return distance != 0 ? normal.dot(toward) / distance : 1 / surface_.vertices[a].norm();
  }

  Border border(std::uint32_t a, std::uint32_t b) const {
    const auto& vertices = surface_.vertices;
    const float range_a = vertices[a].norm(), range_b = vertices[b].norm();
    const Vector toward_a = vertices[a] / range_a, toward_b = vertices[b] / range_b;
    // Planes are linear in nearness. Where each is the nearer one at its own end they meet on the
    // way, as the road and a wall do.
    const float lead_a = 1 / range_a - plane_nearness(b, toward_a);
    const float lead_b = 1 / range_b - plane_nearness(a, toward_b);
    if (lead_a > 0 && lead_b > 0) {
      const float share = lead_a / (lead_a + lead_b);
      const Vector toward = toward_a * (1 - share) + toward_b * share;
      const float nearness = plane_nearness(a, toward);
      if (nearness > 0) return {toward / nearness, toward / nearness};
    }
    const float least = std::min(1 / range_a, 1 / range_b);
    const float most = std::max(1 / range_a, 1 / range_b);
    const auto last = [&](std::uint32_t from, const Vector& here, const Vector& there) -> Vector {
      const Vector toward = (here * (1 - kWay) + there * kWay).normalized();
      return toward / std::clamp(plane_nearness(from, toward), least, most);
    };
    return {last(a, toward_a, toward_b), last(b, toward_b, toward_a)};
  }

  std::uint32_t add(const Vector& vertex) {
    surface_.vertices.push_back(vertex);
    return static_cast<std::uint32_t>(surface_.vertices.size() - 1);
  }

  PartedSurface& surface_;
  const std::vector<Vector>& normals_;
};

/// The corner on its own side of the jump: that of another owner, else the nearest or the farthest,
/// whichever lies farther from the middle one.
int corner_alone(const std::vector<Vector>& vertices, const std::uint32_t corner[3],
                 const std::vector<std::uint32_t>& owner) {
  for (int i = 0; i < 3; ++i)
    if (owner[corner[i]] != owner[corner[(i + 1) % 3]] &&
        owner[corner[(i + 1) % 3]] == owner[corner[(i + 2) % 3]])
      return i;
  float range[3];
  for (int i = 0; i < 3; ++i) range[i] = vertices[corner[i]].norm();
  int order[3] = {0, 1, 2};
  std::sort(order, order + 3, [&](int a, int b) { return range[a] < range[b]; });
  const bool nearest = range[order[1]] - range[order[0]] > range[order[2]] - range[order[1]];
  return order[nearest ? 0 : 2];
}

}  // namespace

PartedSurface part_surface(const Points& points, const std::uint32_t (*triangles)[3],
                           const std::uint8_t* cut, std::size_t count,
                           const std::vector<std::uint32_t>& owner, std::size_t owners) {
  PartedSurface surface;
  surface.vertices.reserve(points.rows() + points.rows() / 2);
  for (Eigen::Index i = 0; i < points.rows(); ++i) surface.vertices.push_back(points.row(i));
  surface.normals.assign(points.rows(), Vector::Zero());
  surface.parts.resize(owners);
  surface.parts[0].whole.reserve(count);
  std::vector<std::size_t> jumps;
  for (std::size_t t = 0; t < count; ++t) {
    const auto [i, j, k] = triangles[t];
    if (cut[t] || owner[i] != owner[j] || owner[j] != owner[k]) {
      if (owner[i] || owner[j] || owner[k]) jumps.push_back(t);
      continue;
    }
    surface.parts[owner[i]].whole.push_back({i, j, k});
    const Vector &p = surface.vertices[i], &q = surface.vertices[j], &r = surface.vertices[k];
    const Vector normal = (q - p).cross(r - p);
    for (const auto corner : {i, j, k}) surface.normals[corner] += normal;
  }
  Splitter splitter(surface, surface.normals);
  for (const std::size_t t : jumps) {
    const auto* corner = triangles[t];
    const int alone = corner_alone(surface.vertices, corner, owner);
    const std::uint32_t i = corner[alone], j = corner[(alone + 1) % 3], k = corner[(alone + 2) % 3];
    const bool own = owner[i] == owner[j] && owner[j] == owner[k];
    const auto part = [&](std::uint32_t of) -> Triangles* {
      if (!of) return nullptr;
      return own ? &surface.parts[of].inner : &surface.parts[of].outer;
    };
    splitter.split(i, j, k, part(owner[i]), part(owner[j]));
  }
  return surface;
}

}  // namespace docdepth
