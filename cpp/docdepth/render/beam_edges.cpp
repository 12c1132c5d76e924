#include "docdepth/render/beam_edges.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

/// The way to the nearer surface at a return beside depth jumps.
struct Turn {
  Vector toward = Vector::Zero();
  float weight = 0, nearest = std::numeric_limits<float>::infinity();

  /// @param across  from the direction of the return of the farther surface to that of the other
  void add(const Vector& across) {
    const float angle = across.norm();
    if (!(angle > 0)) return;
    const float close = 1 / (angle * angle);  // of a ring, and seldom of another ring
    toward += across * (close / angle);
    weight += close;
    nearest = std::min(nearest, angle);
  }
};

}  // namespace

Matrix narrow_beams(const Points& points, const std::uint32_t (*triangles)[3],
                    const std::uint8_t* discontinuity, std::size_t triangle_count, float widening) {
  Matrix narrowed = points;
  std::vector<Turn> turns(points.rows());
  for (std::size_t t = 0; t < triangle_count; ++t) {
    if (!discontinuity[t]) continue;
    float range[3], change[3];
    for (int k = 0; k < 3; ++k) range[k] = points.row(triangles[t][k]).norm();
    for (int k = 0; k < 3; ++k) change[k] = std::fabs(range[k] - range[(k + 1) % 3]);
    const float most = std::max({change[0], change[1], change[2]});
    for (int k = 0; k < 3; ++k) {
      if (change[k] < most / 2) continue;  // of one surface
      const bool first = range[k] < range[(k + 1) % 3];
      const std::uint32_t near = triangles[t][first ? k : (k + 1) % 3];
      const std::uint32_t far = triangles[t][first ? (k + 1) % 3 : k];
      const Vector across = (points.row(near).normalized() - points.row(far).normalized());
      turns[near].add(across);
      turns[far].add(across);
    }
  }
  for (std::size_t i = 0; i < turns.size(); ++i) {
    const Turn& turn = turns[i];
    if (!(turn.weight > 0)) continue;
    const Vector point = points.row(i);
    const float range = point.norm(), angle = std::min(widening, turn.nearest / 2);
    narrowed.row(i) = range * (point / range + angle / turn.weight * turn.toward).normalized();
  }
  return narrowed;
}

}  // namespace docdepth
