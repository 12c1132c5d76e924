#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "docdepth/render/constants.hpp"
#include "docdepth/render/mesh_frame.hpp"

using namespace docdepth;

namespace {

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

constexpr int kRayColumns = 720, kRayRings = 9;
constexpr float kRange = 40.0f, kRayStep = 2 * 3.14159265f / kRayColumns;  // half a degree

/// Returns on a cylinder around the sensor, ring after ring.
Matrix cylinder() {
  Matrix points(kRayColumns * kRayRings, 3);
  for (int i = 0; i < points.rows(); ++i) {
    const float azimuth = (float(i % kRayColumns) + 0.3f) * kRayStep;
    points.row(i) = kRange * Eigen::Vector3f(std::cos(azimuth), std::sin(azimuth),
                                             kRayStep * float(i / kRayColumns - kRayRings / 2));
  }
  return points;
}

}  // namespace

TEST_CASE("an object has the rays near it in any direction, however wide it is") {
  const Matrix points = cylinder();
  const Points all = points;
  const std::vector<std::uint16_t> classid(points.rows(), kDynamic);
  const std::vector<Eigen::Vector3f> normals(points.rows(), Eigen::Vector3f::Zero());
  const std::vector<ObjectMotion> motions(1, {Eigen::Vector3f::Zero(), 0});
  const auto beside = int(0.044f / kRayStep);  // columns or rings
  for (const int width : {1, 20, 80, 100, 300})
    for (int first = 0; first < kRayColumns; first += 24) {
      std::vector<std::uint16_t> object_index(points.rows(), 0);
      for (int k = 0; k < width; ++k)
        object_index[kRayRings / 2 * kRayColumns + (first + k) % kRayColumns] =
            1;  // of the middle ring
      const std::vector<Rays> rays =
          object_rays({all, nullptr, nullptr, 0, nullptr, 0, 0, classid.data(), object_index.data(),
                       motions, nullptr, nullptr, nullptr, nullptr},
                      normals);
      REQUIRE(rays.size() == 1);
      const Rays::Cells& cells = rays[0].cells();
      const int rings = std::min(2 * beside + 1, kRayRings);
      CHECK(int(cells.ends.size()) == rings * (width + 2 * beside));
      CHECK(std::count(cells.moving.begin(), cells.moving.end(), 1) == width);
      for (const Rays::End& end : cells.ends) REQUIRE(end.range > kRange * 0.99f);
    }
}
