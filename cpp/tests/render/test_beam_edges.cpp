#include <doctest/doctest.h>

#include <cmath>
#include <vector>

#include "docdepth/mesh/scan_mesh.hpp"
#include "docdepth/render/beam_edges.hpp"

using namespace docdepth;

namespace {

constexpr int kColumns = 101, kRings = 9, kMiddle = kRings / 2 * kColumns;
constexpr float kStep = 0.003f, kRing = 0.007f;  // radians from beam to beam

struct Sweep {
  Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> points;
  float shift;  ///< of the first column [rad]

  /// A thing from azimuth -half to half, 10 m away, before a wall 20 m away.
  Sweep(float half, float start) : points(kColumns * kRings, 3), shift(start) {
    for (int i = 0; i < points.rows(); ++i) {
      const float azimuth = azimuth_of(i % kColumns), elevation = kRing * float(i / kColumns - 4);
      const float range = std::fabs(azimuth) < half ? 10.0f : 20.0f;
      points.row(i) = range * Eigen::Vector3f(std::cos(azimuth), std::sin(azimuth), elevation);
    }
  }
  float azimuth_of(int column) const { return kStep * float(column - kColumns / 2) + shift; }

  auto narrowed(float widening) const {
    const Points all = points;
    const ScanMesh mesh = build_scan_mesh(all, {});
    const auto* corners = reinterpret_cast<const std::uint32_t (*)[3]>(mesh.triangles.data());
    return narrow_beams(all, corners, mesh.discontinuity.data(), mesh.triangles.size(), widening);
  }
};

float azimuth(const Eigen::Vector3f& point) {
  return std::atan2(point.y(), point.x());
}

}  // namespace

TEST_CASE("a thing seen by wide beams becomes as wide as it is") {
  const float half = 0.05f, beam = 0.001f;  // its returns reach a beam farther to each side
  double left = 0, right = 0;
  const int trials = 30;
  for (int k = 0; k < trials; ++k) {
    const Sweep sweep(half + beam, kStep * (float(k) + 0.5f) / trials);
    const auto points = sweep.narrowed(beam);
    for (int i = 0; i < points.rows(); ++i)
      REQUIRE(points.row(i).norm() == doctest::Approx(sweep.points.row(i).norm()));
    for (int i = kMiddle; i + 1 < kMiddle + kColumns; ++i) {
      const bool near = points.row(i).norm() < 15, next = points.row(i + 1).norm() < 15;
      const float edge = (azimuth(points.row(i)) + azimuth(points.row(i + 1))) / 2;
      if (next && !near) right += edge / trials;
      if (near && !next) left += edge / trials;
    }
    // What is not beside an edge stays.
    CHECK(points.row(kMiddle + 50) == sweep.points.row(kMiddle + 50));
    CHECK(points.row(kMiddle + 5) == sweep.points.row(kMiddle + 5));
  }
  CHECK(left == doctest::Approx(half).epsilon(0.003));
  CHECK(right == doctest::Approx(-half).epsilon(0.003));
}

TEST_CASE("a post of one return stays, and nothing is turned past the middle of two beams") {
  const Sweep post(kStep / 2, 0);
  const auto points = post.narrowed(0.001f);
  const int at = kMiddle + kColumns / 2;
  CHECK((points.row(at) - post.points.row(at)).norm() < 1e-3f * kStep * 10);
  CHECK(azimuth(points.row(at + 1)) == doctest::Approx(kStep - 0.001f).epsilon(0.02));
  const Sweep thing(0.05f, 0);
  const auto most = thing.narrowed(1.0f);
  for (int i = kMiddle; i + 1 < kMiddle + kColumns; ++i)
    CHECK(azimuth(most.row(i)) < azimuth(most.row(i + 1)));
}
