#include <doctest/doctest.h>

#include <cmath>
#include <random>

#include "docdepth/render/cloud.hpp"
#include "docdepth/render/edges.hpp"
#include "docdepth/render/splats.hpp"
#include "docdepth/render/triangles.hpp"

using namespace docdepth;

namespace {

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

Matrix random_points(int count, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> side(0.0f, 20.0f);
  Matrix points(count, 3);
  for (int i = 0; i < count; ++i)
    for (int k = 0; k < 3; ++k) points(i, k) = side(random);
  return points;
}

Cloud cloud_of(const Matrix& points) {
  return Cloud(points, std::vector<std::uint8_t>(points.rows(), 1));
}

}  // namespace

TEST_CASE("splat heights follow the formula, at its borders too") {
  const SplatSize size{50, 3};
  const SplatHeights heights(size);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> logarithm(-8, 14);
  for (int i = 0; i < 200000; ++i) {
    const auto squared = static_cast<float>(std::exp(logarithm(random)));
    const double sigma =
        squared < 1.65 * 1.65 ? 50.0 : std::max(50.0 / std::log(double(squared)), 3.0);
    REQUIRE(heights(squared) == static_cast<int>(std::floor(sigma + 0.5)));
  }
  CHECK(heights(0.0f) == 50);
  CHECK(heights(INFINITY) == 3);
  CHECK(heights.largest() == 50);
}

TEST_CASE("a cloud keeps every wanted point in exactly one block, inside its box") {
  const Matrix points = random_points(5000, 2);
  std::vector<std::uint8_t> keep(points.rows());
  for (std::size_t i = 0; i < keep.size(); ++i) keep[i] = i % 3 != 0;
  const Cloud cloud(points, keep);
  CHECK(cloud.size() == 3333);
  std::uint32_t next = 0;
  for (const auto& block : cloud.blocks()) {
    REQUIRE(block.begin == next);
    REQUIRE(block.end - block.begin <= Cloud::kBlock);
    for (std::uint32_t i = block.begin; i < block.end; ++i) {
      const Eigen::Vector3f p(cloud.x()[i], cloud.y()[i], cloud.z()[i]);
      REQUIRE(((p - block.box.center).array().abs() <= block.box.extent.array()).all());
    }
    next = block.end;
  }
  CHECK(next == cloud.size());
}

TEST_CASE("a frustum never hides a box that holds a visible point") {
  const Camera camera{100, 110, 60, 20, 130, 50};
  Pose T = Pose::Identity();
  T.rotate(Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()));
  T.translation() << 1, -2, 0.5;
  const Frustum frustum(camera, T);
  const Matrix points = random_points(20000, 3);
  int hidden = 0;
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const Eigen::Vector3f point = points.row(i);
    const Eigen::Vector3d p = T * point.cast<double>();
    const double u = 100 * p.x() / p.z() + 60, v = 110 * p.y() / p.z() + 20;
    const bool seen = p.z() > kNear && u > -0.5 && u < 129.5 && v > -0.5 && v < 49.5;
    const bool touches = frustum.touches({point, Eigen::Vector3f::Zero()});
    if (seen) REQUIRE(touches);
    hidden += !touches;
  }
  CHECK(hidden > 15000);
}

TEST_CASE("rendering does not depend on threads, and nothing gives no depth") {
  const Camera camera{100, 100, 60, 20, 130, 50};
  const Cloud cloud = cloud_of(random_points(20000, 4)), none;
  const SplatHeights heights({50, 3});
  const Pose T = Pose::Identity();
  const auto one = render_splats(camera, {{&cloud, T, &heights}}, 1);
  const auto three = render_splats(camera, {{&cloud, T, &heights}, {&none, T, &heights}}, 3);
  for (std::size_t i = 0; i < one.size(); ++i)
    REQUIRE((one[i] == three[i] || (std::isnan(one[i]) && std::isnan(three[i]))));
  for (const float depth : render_splats(camera, {{&none, T, &heights}}, 2))
    REQUIRE(std::isnan(depth));
  for (const float depth : render_splats(camera, {}, 2)) REQUIRE(std::isnan(depth));
}

TEST_CASE("the nearer triangle of a layer wins; a layer hides those before it only if it says so") {
  const Camera camera{100, 100, 10, 10, 21, 21};
  const auto square = [](float z, float from = -5) {
    return Mesh({{from, -5, z}, {5, -5, z}, {5, 5, z}, {from, 5, z}}, {{0, 1, 2}, {0, 2, 3}});
  };
  const Mesh far = square(10), near = square(5), half = square(5, 0.01f);
  const Pose T = Pose::Identity();
  for (const float depth : render_triangles(camera, {{{{&far, T}, {&near, T}}}}, 1))
    REQUIRE(depth == doctest::Approx(5));
  for (const float depth : render_triangles(camera, {{{{&far, T}}}, {{{&near, T}}}}, 1))
    REQUIRE(depth == doctest::Approx(10));
  for (const bool nearer_first : {true, false}) {
    const Mesh &first = nearer_first ? near : far, &second = nearer_first ? far : near;
    for (const float depth : render_triangles(camera, {{{{&first, T}}}, {{{&second, T}}, true}}, 1))
      REQUIRE(depth == doctest::Approx(5));
  }
  const auto filled = render_triangles(camera, {{{{&half, T}}}, {{{&far, T}}}}, 1);
  for (int i = 0; i < 21 * 21; ++i) REQUIRE(filled[i] == doctest::Approx(i % 21 > 10 ? 5 : 10));
}

TEST_CASE("a cut triangle is split in the middle of its angle, each part at its corners' range") {
  Matrix points(3, 3);
  points << 10, 0, 0, 20, 1, 0, 20, 0, 1;
  const std::uint32_t triangle[1][3] = {{0, 1, 2}};
  const std::uint8_t whole = 0, cut = 1;
  const std::uint16_t fixed[3] = {50, 50, 50}, mixed[3] = {50, 100, 50};
  CHECK(part_surface(points, triangle, &whole, 1, fixed).fixed.whole.size() == 1);

  const auto split = part_surface(points, triangle, &cut, 1, fixed);
  CHECK(split.fixed.whole.empty());
  REQUIRE(split.fixed.split.size() == 3);
  for (const auto corner : split.fixed.split[0])
    CHECK(split.vertices[corner].norm() == doctest::Approx(10));
  for (const auto part : {1, 2})
    for (const auto corner : split.fixed.split[part]) CHECK(split.vertices[corner].norm() > 19.9);

  // A class border is never joined, with or without a jump.
  const auto border = part_surface(points, triangle, &whole, 1, mixed);
  CHECK(border.fixed.whole.empty());
  CHECK(border.moving.whole.empty());
  CHECK(border.moving.split.size() == 1);
  CHECK(border.fixed.split.size() == 2);
}
