#include "docdepth/render/edges.hpp"

#include <algorithm>
#include <cmath>

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// Splits triangles between one corner and the other two.
class Splitter {
 public:
  explicit Splitter(PartedSurface& surface) : surface_(surface) {}

  /// @param i corner that is alone; j and k follow it around the triangle
  void split(std::uint32_t i, std::uint32_t j, std::uint32_t k, Triangles& alone,
             Triangles& together) {
    const Middle to_j = middle(i, j), to_k = middle(i, k);
    alone.push_back({i, to_j.first, to_k.first});
    together.push_back({to_j.second, j, k});
    together.push_back({to_j.second, k, to_k.second});
  }

 private:
  /// The middle of an edge as seen from the sensor, at the range of its first end and of its
  /// second.
  struct Middle {
    std::uint32_t first, second;
  };

  Middle middle(std::uint32_t a, std::uint32_t b) {
    auto& vertices = surface_.vertices;
    const Vector p = vertices[a], q = vertices[b];
    const float range_p = p.norm(), range_q = q.norm();
    const Vector toward = (p / range_p + q / range_q).normalized();
    vertices.push_back(toward * range_p);
    vertices.push_back(toward * range_q);
    const auto count = static_cast<std::uint32_t>(vertices.size());
    return {count - 2, count - 1};
  }

  PartedSurface& surface_;
};

}  // namespace

PartedSurface part_surface(const Points& points, const std::uint32_t (*triangles)[3],
                           const std::uint8_t* cut, std::size_t count,
                           const std::uint16_t* classid) {
  PartedSurface surface;
  surface.vertices.reserve(points.rows() + points.rows() / 2);
  for (Eigen::Index i = 0; i < points.rows(); ++i) surface.vertices.push_back(points.row(i));
  Splitter splitter(surface);
  for (std::size_t t = 0; t < count; ++t) {
    const auto* corner = triangles[t];
    bool moves[3];
    float range[3];
    for (int i = 0; i < 3; ++i) {
      moves[i] = classid[corner[i]] >= kDynamic;
      range[i] = surface.vertices[corner[i]].norm();
    }
    const bool one_class = moves[0] == moves[1] && moves[1] == moves[2];
    if (one_class && !cut[t]) {
      (moves[0] ? surface.moving : surface.fixed)
          .whole.push_back({corner[0], corner[1], corner[2]});
      continue;
    }
    int alone = 0;
    if (one_class) {  // the nearest or the farthest, whichever lies farther from the middle one
      int order[3] = {0, 1, 2};
      std::sort(order, order + 3, [&](int a, int b) { return range[a] < range[b]; });
      const bool nearest = range[order[1]] - range[order[0]] > range[order[2]] - range[order[1]];
      alone = order[nearest ? 0 : 2];
    } else {
      while (moves[alone] == moves[(alone + 1) % 3] || moves[alone] == moves[(alone + 2) % 3])
        ++alone;
    }
    const int j = (alone + 1) % 3, k = (alone + 2) % 3;
    auto& first = moves[alone] ? surface.moving : surface.fixed;
    auto& second = moves[j] ? surface.moving : surface.fixed;
    splitter.split(corner[alone], corner[j], corner[k], first.split, second.split);
  }
  return surface;
}

}  // namespace docdepth
