#include "docdepth/render/partitioned_mesh.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "docdepth/mesh/scan_mesh.hpp"
#include "docdepth/render/constants.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// Over a discontinuity of its own an object goes on for this share of the way to the next return:
/// a little past the middle, so that no crack is left.
constexpr float kInnerShare = 0.6f;
/// The same beyond its last return, and for the nearer side of static surface. Rays tell where it
/// ends: almost at the next one if the rays of other sweeps that passed beside it passed there.
constexpr float kOuterShare = 0.98f;

/// Splits triangles between one corner and the other two.
class Splitter {
 public:
  Splitter(PartitionedMesh& mesh, const std::vector<Vector>& normals)
      : mesh_(mesh), normals_(normals) {}

  /// @param i         the corner on its own side; j and k follow it around the triangle
  /// @param alone     receives the side of i; null drops it
  /// @param together  receives the side of j and k; null drops it
  /// @param share     of the way to the other side that a surface goes on
  void split(std::uint32_t i, std::uint32_t j, std::uint32_t k, Triangles* alone,
             Triangles* together, float share) {
    const Border to_j = border(i, j, share), to_k = border(i, k, share);
    if (alone) alone->push_back({i, add(to_j.first, i), add(to_k.first, i)});
    if (!together) return;
    const std::uint32_t beside_j = add(to_j.second, j), beside_k = add(to_k.second, k);
    together->push_back({beside_j, j, k});
    together->push_back({beside_j, k, beside_k});
  }

 private:
  /// The end of the surface on each side of an edge.
  struct Border {
    Vector first, second;
  };

  /// Inverse range, in direction `toward`, of the plane at point a.
  float plane_inverse_range(std::uint32_t a, const Vector& toward) const {
    const Vector& normal = normals_[a];
    const float distance = normal.dot(mesh_.vertices[a]);
    return distance != 0 ? normal.dot(toward) / distance : 1 / mesh_.vertices[a].norm();
  }

  Border border(std::uint32_t a, std::uint32_t b, float most_share) const {
    const auto& vertices = mesh_.vertices;
    const float range_a = vertices[a].norm(), range_b = vertices[b].norm();
    const Vector toward_a = vertices[a] / range_a, toward_b = vertices[b] / range_b;
    // Planes are linear in inverse range. If each is the nearer one at its own end they meet in
    // between, as the road and a wall do.
    const float lead_a = 1 / range_a - plane_inverse_range(b, toward_a);
    const float lead_b = 1 / range_b - plane_inverse_range(a, toward_b);
    if (lead_a > 0 && lead_b > 0) {
      const float share = lead_a / (lead_a + lead_b);
      const Vector toward = toward_a * (1 - share) + toward_b * share;
      const float inverse_range = plane_inverse_range(a, toward);
      if (inverse_range > 0) return {toward / inverse_range, toward / inverse_range};
    }
    const float least = std::min(1 / range_a, 1 / range_b);
    const float most = std::max(1 / range_a, 1 / range_b);
    const auto last = [&](std::uint32_t from, const Vector& here, const Vector& there) -> Vector {
      const Vector toward = (here * (1 - most_share) + there * most_share).normalized();
      return toward / std::clamp(plane_inverse_range(from, toward), least, most);
    };
    return {last(a, toward_a, toward_b), last(b, toward_b, toward_a)};
  }

  std::uint32_t add(const Vector& vertex, std::uint32_t source) {
    mesh_.vertices.push_back(vertex);
    mesh_.sources.push_back(source);
    return static_cast<std::uint32_t>(mesh_.vertices.size() - 1);
  }

  PartitionedMesh& mesh_;
  const std::vector<Vector>& normals_;
};

/// The corner on its own side of the discontinuity: the one of another surface, else the nearest or
/// the farthest, whichever differs more from the middle one.
int corner_alone(const std::vector<Vector>& vertices, const std::uint32_t corner[3],
                 const std::uint16_t* object_index) {
  for (int i = 0; i < 3; ++i)
    if (object_index[corner[i]] != object_index[corner[(i + 1) % 3]] &&
        object_index[corner[(i + 1) % 3]] == object_index[corner[(i + 2) % 3]])
      return i;
  float range[3];
  for (int i = 0; i < 3; ++i) range[i] = vertices[corner[i]].norm();
  int order[3] = {0, 1, 2};
  std::sort(order, order + 3, [&](int a, int b) { return range[a] < range[b]; });
  const bool nearest = range[order[1]] - range[order[0]] > range[order[2]] - range[order[1]];
  return order[nearest ? 0 : 2];
}

/// Whether the range changes steeply along a side: the mesh takes such a triangle for surface only
/// where it continues the plane of a neighbour.
bool is_steep(const std::vector<Vector>& vertices, const std::uint32_t corner[3]) {
  const MeshParameters parameters;
  for (int i = 0; i < 3; ++i) {
    const Vector &a = vertices[corner[i]], &b = vertices[corner[(i + 1) % 3]];
    const float range_a = a.norm(), range_b = b.norm(), change = std::fabs(range_a - range_b);
    const float across = std::min(range_a, range_b) * (a / range_a - b / range_b).norm();
    if (change > std::max(parameters.noise, parameters.jump_ratio * across)) return true;
  }
  return false;
}

}  // namespace

PartitionedMesh partition_mesh(const Points& points, const std::uint32_t (*triangles)[3],
                               const std::uint8_t* discontinuity, std::size_t count,
                               const std::uint16_t* object_index, std::size_t surfaces,
                               const std::uint8_t* drawn) {
  PartitionedMesh mesh;
  mesh.vertices.reserve(points.rows() + points.rows() / 2);
  for (Eigen::Index i = 0; i < points.rows(); ++i) mesh.vertices.push_back(points.row(i));
  mesh.sources.resize(points.rows());
  std::iota(mesh.sources.begin(), mesh.sources.end(), 0);
  mesh.normals.assign(points.rows(), Vector::Zero());
  mesh.parts.resize(surfaces);
  mesh.parts[0].whole.reserve(count);
  std::vector<std::uint8_t> at_jump(points.rows(), 0);
  for (std::size_t t = 0; t < count; ++t)
    for (int i = 0; discontinuity[t] && i < 3; ++i) at_jump[triangles[t][i]] = 1;
  std::vector<std::size_t> jumps;
  for (std::size_t t = 0; t < count; ++t) {
    const auto [i, j, k] = triangles[t];
    if (discontinuity[t] || object_index[i] != object_index[j] ||
        object_index[j] != object_index[k]) {
      jumps.push_back(t);
      continue;
    }
    if (!object_index[i] && at_jump[i] && at_jump[j] && at_jump[k] &&
        is_steep(mesh.vertices, triangles[t]))
      continue;
    mesh.parts[object_index[i]].whole.push_back({i, j, k});
    const Vector &p = mesh.vertices[i], &q = mesh.vertices[j], &r = mesh.vertices[k];
    const Vector normal = (q - p).cross(r - p);
    for (const auto corner : {i, j, k}) mesh.normals[corner] += normal;
  }
  Splitter splitter(mesh, mesh.normals);
  for (const std::size_t t : jumps) {
    const auto* corner = triangles[t];
    const int alone = corner_alone(mesh.vertices, corner, object_index);
    const std::uint32_t i = corner[alone], j = corner[(alone + 1) % 3], k = corner[(alone + 2) % 3];
    const bool own = object_index[i] == object_index[j] && object_index[j] == object_index[k];
    if (own && !object_index[i]) {
      Triangles* outer = &mesh.parts[0].outer;
      const bool nearer = points.row(i).norm() < points.row(j).norm();
      splitter.split(i, j, k, nearer ? outer : nullptr, nearer ? nullptr : outer, kOuterShare);
      continue;
    }
    const auto part = [&](std::uint32_t of) -> Triangles* {
      if (!of || (drawn && !drawn[of - 1])) return nullptr;
      return own ? &mesh.parts[of].inner : &mesh.parts[of].outer;
    };
    splitter.split(i, j, k, part(object_index[i]), part(object_index[j]),
                   own ? kInnerShare : kOuterShare);
  }
  return mesh;
}

}  // namespace docdepth
