#include <doctest/doctest.h>

#include <cmath>
#include <memory>
#include <vector>

#include "docdepth/detections/ground_grid.hpp"

using namespace docdepth;

namespace {

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

constexpr float kSlope = 0.05f, kAcross = -0.02f, kHigh = 40;

float height_at(float x, float y) {
  return kHigh + kSlope * x + kAcross * y;
}

/// Ground in a rectangle, seen by a LiDAR 1.7 m above it at (50, 20).
GroundGrid ground(float low_x, float high_x, float low_y, float high_y) {
  std::vector<Eigen::Vector3f> points;
  const Eigen::Vector3f lidar(50, 20, height_at(50, 20) + 1.7f);
  for (float x = low_x; x < high_x; x += 0.23f)
    for (float y = low_y; y < high_y; y += 0.27f)
      points.push_back(Eigen::Vector3f(x, y, height_at(x, y)) - lidar);
  Matrix rows(points.size() + 1, 3);
  for (std::size_t i = 0; i < points.size(); ++i) rows.row(i) = points[i].transpose();
  rows.row(points.size()) = Eigen::RowVector3f(0, 0, 30);  // no ground
  const auto flags = std::make_unique<bool[]>(rows.rows());
  for (std::size_t i = 0; i < points.size(); ++i) flags[i] = true;
  Pose T = Pose::Identity();
  T.translate(lidar.cast<double>());
  return GroundGrid(rows, flags.get(), RigidTransform(T));
}

const Extent kBox{{60, 20, 41}, {64, 22, 42.5f}};
const float kUnder = height_at(62, 21);

}  // namespace

TEST_CASE("the ground under an object is that around it, also uphill") {
  const GroundHeight all_around = ground(52, 72, 12, 30).under(kBox);
  CHECK(std::fabs(all_around.value - kUnder) < 0.05f);
  CHECK(all_around.deviation < 0.15f);
  // Of what stands between the LiDAR and the ground behind it one side is seen.
  const GroundHeight one_side = ground(52, 60, 12, 30).under(kBox);
  CHECK(std::fabs(one_side.value - kUnder) < 0.1f);
  CHECK(one_side.deviation > all_around.deviation);
}

TEST_CASE("what was not seen is not known") {
  CHECK(std::isinf(ground(30, 50, 10, 20).under(kBox).deviation));
  const Extent far{{240, 20, 40}, {242, 21, 41}};
  CHECK(std::isinf(ground(52, 72, 12, 30).under(far).deviation));
}
