#include <doctest/doctest.h>

#include <stdexcept>

#include "docdepth/geometry/rigid.hpp"
#include "docdepth/geometry/spherical.hpp"

using namespace docdepth;

TEST_CASE("pixels of the six directions") {
  const SphericalGrid grid(0.2 * M_PI / 180.0);
  CHECK(grid.columns() == 1800);
  CHECK(grid.column(-1.0f, 0.0f) == 0);
  CHECK(grid.column(-1.0f, -0.0f) == 0);
  CHECK(grid.column(1.0f, 0.0f) == 900);
  CHECK(grid.column(0.1f, 1.0f) == 478);  // left, before the half of the first half
  CHECK(grid.column(0.1f, -1.0f) == 1321);
  CHECK(grid.row(1.0f, 1.0f) == 0);
  CHECK(grid.row(-1.0f, 1.0f) == 900);
  CHECK(grid.row(1.0f, 0.99999f) == 0);  // rounding may make z larger than rho
  CHECK_THROWS_AS(SphericalGrid(0.0), std::invalid_argument);
}

TEST_CASE("a relative pose takes points from one frame to the other") {
  Pose a = Pose::Identity(), b = Pose::Identity();
  a.rotate(Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()))
      .pretranslate(Eigen::Vector3d(4, 5, 6));
  b.rotate(Eigen::AngleAxisd(-1.1, Eigen::Vector3d(3, -1, 2).normalized()))
      .pretranslate(Eigen::Vector3d(1e3, 2, 1));
  const Eigen::Vector3d p(1, -2, 0.5);
  CHECK((a * (between(a, b) * p) - b * p).norm() < 1e-9);
}
