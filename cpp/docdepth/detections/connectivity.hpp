// Points that the edges of a mesh connect.
#pragma once

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

#include "docdepth/geometry/spherical.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/mesh/scan_mesh.hpp"

namespace docdepth {

/// At most this share of the distance between connected points lies along the rays. It is that of a
/// surface seen at 10 degrees; at a smaller angle, people who walk in file would be one object.
constexpr float kMaxShareAlongRay = 0.985f;

inline float squared_distance(const Points& points, std::uint32_t a, std::uint32_t b) {
  const float x = points(a, 0) - points(b, 0), y = points(a, 1) - points(b, 1),
              z = points(a, 2) - points(b, 2);
  return (x * x + y * y) + z * z;
}

/// Union-find of points.
class DisjointSets {
 public:
  explicit DisjointSets(std::size_t count) : parent_(count) {
    std::iota(parent_.begin(), parent_.end(), 0u);
  }
  std::uint32_t find(std::uint32_t a) {
    while (parent_[a] != a) a = parent_[a] = parent_[parent_[a]];
    return a;
  }
  /// Whether two points are known to be joined, without a search: false says nothing.
  bool have_joined(std::uint32_t a, std::uint32_t b) const { return parent_[a] == parent_[b]; }
  void join(std::uint32_t a, std::uint32_t b) {
    a = find(a);
    b = find(b);
    if (a != b) parent_[std::max(a, b)] = std::min(a, b);
  }
  /// The first point of the set of each point.
  std::vector<std::uint32_t> first() {
    std::vector<std::uint32_t> result(parent_.size());
    for (std::uint32_t i = 0; i < result.size(); ++i) result[i] = find(i);
    return result;
  }

 private:
  std::vector<std::uint32_t> parent_;
};

/// Join the corners of triangles that take part, up to a distance of `near`, or of `growth` times
/// their range where they do not lie one behind the other.
/// @param discontinuity  of the triangles that are used
template <class TakesPart>
void join_corners(const Points& points, const ScanMesh& mesh, bool discontinuity, float near,
                  float growth, const TakesPart& takes_part, DisjointSets& sets) {
  const auto range = [&](std::uint32_t i) {
    return range_of(points(i, 0), points(i, 1), points(i, 2));
  };
  const auto connected = [&](std::uint32_t a, std::uint32_t b) {
    const float squared = squared_distance(points, a, b);
    if (squared < near * near) return true;  // as most are, so the range need not be computed
    const float range_a = range(a), range_b = range(b);
    const float distance = growth * std::min(range_a, range_b), along = range_a - range_b;
    return squared < distance * distance &&
           along * along <= kMaxShareAlongRay * kMaxShareAlongRay * squared;
  };
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (bool(mesh.discontinuity[t]) != discontinuity) continue;
    const auto& corners = mesh.triangles[t];
    const bool in[3] = {takes_part(corners[0]), takes_part(corners[1]), takes_part(corners[2])};
    if (in[0] + in[1] + in[2] < 2) continue;
    for (int i = 0, j = 2; i < 3; j = i++)
      if (in[i] && in[j] && !sets.have_joined(corners[i], corners[j]) &&
          connected(corners[i], corners[j]))
        sets.join(corners[i], corners[j]);
  }
}

}  // namespace docdepth
