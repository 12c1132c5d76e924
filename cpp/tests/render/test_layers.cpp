#include <doctest/doctest.h>

#include <cmath>

#include "docdepth/render/layers.hpp"

using namespace docdepth;

namespace {

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

const Camera kCamera{100, 100, 10, 10, 21, 21};

PatchMesh square(float z, std::uint8_t classid) {
  return PatchMesh({{-5, -5, z}, {5, -5, z}, {5, 5, z}, {-5, 5, z}}, {{0, 1, 2}, {0, 2, 3}},
                   std::vector<std::uint8_t>(4, classid));
}

}  // namespace

TEST_CASE("layers of triangles tell which mesh is seen, and how many agree") {
  const PatchMesh wall = square(10, kStatic), again = square(10.1f, kGround),
                  near = square(5, kStatic);
  const PatchMesh dynamic_mesh = square(4, kDynamic), other = square(4.02f, kDynamic);
  const Pose T = Pose::Identity();
  MeshScene scene;
  scene.nearest = {{&wall, T, 0}};
  scene.others = {{&again, T, 1}, {&near, T, 2}, {&near, T, 0, true}};
  const std::vector<float> depth(21 * 21, 10.0f);
  for (const int threads : {1, 3}) {
    const Layers layers = layers_of_triangles(kCamera, scene, depth.data(), false, threads);
    for (int i = 0; i < 21 * 21; ++i) {
      REQUIRE(layers.sweep[i] == 0);
      REQUIRE(layers.classid[i] == kStatic);
      REQUIRE(layers.measured[i] == 1);
      REQUIRE(layers.support[i] == 2);
      REQUIRE(layers.measures[i] == 3);
      REQUIRE(layers.deviation[i] == doctest::Approx(0.1 / std::sqrt(2.0)).epsilon(1e-3));
      REQUIRE(layers.normal[3 * i + 2] == doctest::Approx(-1));
      const double u = (i % 21 - 10) / 10.0, v = (i / 21 - 10) / 10.0;
      REQUIRE(layers.range[i] == doctest::Approx(std::sqrt(u * u + v * v + 100)));
    }
  }
  // What moves is held against what moves; without depth there is nothing.
  scene.dynamic_objects = {
      {{{&dynamic_mesh, T, 3}}, {{&other, T, 4, false, 7}}, {}, {}, {0, 21, 0, 21}}};
  std::vector<float> nearer(21 * 21, 4.02f);
  nearer[7] = NAN;
  const Layers layers = layers_of_triangles(kCamera, scene, nearer.data(), false, 2);
  CHECK(layers.sweep[0] == 4);
  CHECK(layers.classid[0] == kDynamic);
  CHECK(layers.instance[0] == 7);
  CHECK(layers.instance[7] == 0);
  CHECK(layers.support[0] == 2);
  CHECK(layers.measures[0] == 2);
  CHECK(layers.sweep[7] == -1);
  CHECK(layers.classid[7] == kNoClass);
  CHECK(layers.support[7] == 0);
  CHECK(std::isnan(layers.range[7]));
}

TEST_CASE("layers of splats tell which point is seen, and how many agree") {
  Matrix points(4, 3);
  points << 0, 0, 10, 0, 0, 10.1f, 0, 0, 20, 0.9f, 0, 10;
  const std::uint16_t classes[] = {10, 60, 251, 99};
  const Cloud cloud(points, {1, 1, 1, 1}, classes);
  const SplatHeights heights({3, 3});  // one pixel to each side: 9 du^2 + 4 dv^2 <= 9
  const std::vector<PlacedCloud> placed{{&cloud, Pose::Identity(), &heights, 5}};
  const auto depth = render_splats(kCamera, placed, 1);
  for (const int threads : {1, 3}) {
    const Layers layers = layers_of_splats(kCamera, placed, depth.data(), threads);
    for (int i = 0; i < 21 * 21; ++i) {
      REQUIRE((layers.sweep[i] < 0) == std::isnan(depth[i]));
      REQUIRE((layers.classid[i] == kNoClass) == std::isnan(depth[i]));
    }
    const int middle = 10 * 21 + 10, right = middle + 9;
    CHECK(layers.sweep[middle] == 5);
    CHECK(layers.classid[middle] == kGround);
    CHECK(layers.support[middle] == 2);
    CHECK(layers.measures[middle] == 3);
    CHECK(layers.range[middle] == doctest::Approx(10));
    CHECK(layers.deviation[middle] == doctest::Approx(0.1 / std::sqrt(2.0)).epsilon(1e-3));
    CHECK(layers.classid[right] == kStatic);
    CHECK(layers.support[right] == 1);
    CHECK(std::isnan(layers.deviation[right]));
  }
  CHECK(layers_of_splats(kCamera, {}, depth.data(), 2).sweep[0] == -1);
}
