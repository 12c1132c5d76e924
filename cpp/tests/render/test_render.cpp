#include <doctest/doctest.h>

#include <cmath>
#include <random>

#include "docdepth/render/cloud.hpp"
#include "docdepth/render/partitioned_mesh.hpp"
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

/// A square across the optical axis, on which the camera sits.
PatchMesh square(float z, float from = -5, float to = 5) {
  return PatchMesh({{from, -5, z}, {to, -5, z}, {to, 5, z}, {from, 5, z}}, {{0, 1, 2}, {0, 2, 3}});
}

/// Rays `spacing` apart at 5 m that end at `range`, of which one passes `aside` of the middle of
/// the image.
Rays sweep(float range, float spacing, float aside) {
  Matrix points(41 * 41, 3);
  for (int i = 0; i < 41; ++i)
    for (int j = 0; j < 41; ++j)
      points.row(41 * i + j) =
          Eigen::Vector3f(5, spacing * float(i - 20) + aside, spacing * float(j - 20)) *
          (range / 5);
  return Rays(points, std::vector<Eigen::Vector3f>(points.rows(), Eigen::Vector3f::Zero()));
}

/// Of a sensor at the camera, x ahead.
Pose looking_ahead() {
  Pose T_camera_sensor = Pose::Identity();
  T_camera_sensor.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  return T_camera_sensor;
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

TEST_CASE("without rays the first sweep with a depth wins, and dynamic objects hide it") {
  const Camera camera{100, 100, 10, 10, 21, 21};
  const PatchMesh far = square(10), near = square(5), half = square(12, 0.01f);
  const Pose T = Pose::Identity();
  const auto depth = [&](const std::vector<const PatchMesh*>& nearest,
                         const std::vector<const PatchMesh*>& others,
                         const std::vector<const PatchMesh*>& dynamic_meshes, int pixel) {
    MeshScene scene;
    for (const PatchMesh* mesh : nearest) scene.nearest.push_back({mesh, T});
    for (const PatchMesh* mesh : others) scene.others.push_back({mesh, T});
    for (const PatchMesh* mesh : dynamic_meshes)
      scene.dynamic_objects.push_back({{{mesh, T}}, {}, {}, {}, {0, 21, 0, 21}});
    return doctest::Approx(render_triangles(camera, scene, 1)[pixel]);
  };
  for (int i = 0; i < 21 * 21; ++i) {
    CHECK(depth({&far, &near}, {}, {}, i) == 5);
    CHECK(depth({&far}, {&near}, {}, i) == 10);
    CHECK(depth({}, {&far, &near, &near}, {}, i) == 10);
    CHECK(depth({}, {&near, &far}, {}, i) == 5);
    CHECK(depth({&far}, {}, {&near}, i) == 5);
    CHECK(depth({&near}, {}, {&far}, i) == 5);
    CHECK(depth({&half}, {&far, &near}, {}, i) == (i % 21 > 10 ? 12 : 10));
  }
}

TEST_CASE(
    "rays tell a surface from what was looked through, at edges and where the nearest sweep saw "
    "nothing") {
  const Camera camera{100, 100, 10, 10, 21, 21};
  const PatchMesh far = square(10), near = square(5), nearer = square(2.5f),
                  half = square(10, 0.05f);
  const PatchMesh beyond({{-5, -5, 5},
                          {0.275f, -5, 5},
                          {0.275f, 5, 5},
                          {-5, 5, 5},
                          {0.55f, -5, 10},
                          {5, -5, 10},
                          {5, 5, 10},
                          {0.55f, 5, 10}},
                         {{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {4, 6, 7}});
  // A sensor at the camera, x ahead: its rays end at 5 m in the right half of the image (y < 0),
  // at 10 m in the left one.
  Matrix points(200 * 200, 3);
  for (int i = 0; i < 200; ++i)
    for (int j = 0; j < 200; ++j) {
      const float left = 0.002f * float(i - 100) + 1e-4f, up = 0.002f * float(j - 100);
      points.row(200 * i + j) = Eigen::Vector3f(1, left, up) * (left < 0 ? 5.0f : 10.0f);
    }
  const Rays rays(points, std::vector<Eigen::Vector3f>(points.rows(), Eigen::Vector3f::Zero()));
  const Pose T_camera_sensor = looking_ahead();
  const auto draw = [&](const PatchMesh* nearest, const std::vector<const PatchMesh*>& others) {
    MeshScene scene;
    if (nearest) scene.nearest.push_back({nearest, Pose::Identity()});
    for (const PatchMesh* mesh : others) scene.others.push_back({mesh, Pose::Identity()});
    scene.rays.push_back({&rays, T_camera_sensor});
    return render_triangles(camera, scene, 1);
  };
  for (int i = 0; i < 21 * 21; ++i) {
    if (i % 21 == 10) continue;  // on the edge
    const bool right = i % 21 > 10;
    const auto truth = doctest::Approx(right ? 5 : 10);
    CHECK(draw(nullptr, {&near, &far})[i] == truth);
    CHECK(draw(nullptr, {&far, &near})[i] == truth);
    CHECK(draw(nullptr, {&nearer, &far, &near})[i] == truth);
    CHECK(draw(nullptr, {&far, &nearer})[i] == doctest::Approx(10));  // neither is there
    CHECK(draw(&far, {&near})[i] == doctest::Approx(10));             // no edge, so no ray decides
    // The tiles in which the nearest sweep has its edge are open: the columns 8 to 15.
    const bool open = i % 21 < 16;
    CHECK(draw(&half, {&near, &far})[i] == (open ? truth : doctest::Approx(10)));
    // So are those on both sides of an edge: this one lies between the columns 15 and 16.
    CHECK(draw(&beyond, {&near, &far})[i] == (i % 21 < 8 ? doctest::Approx(5) : truth));
  }
}

TEST_CASE("rays are queried in the order in which they win until the score is sure") {
  const Camera camera{100, 100, 3, 3, 7, 7};
  const PatchMesh far = square(10), near = square(5);
  const float spacing = 0.05f;
  const Rays met = sweep(5, spacing, 0), met_aside = sweep(5, spacing, 0.018f),
             passed = sweep(10, spacing, 0);
  const Pose T_camera_sensor = looking_ahead();
  const auto middle = [&](const std::vector<const Rays*>& rays) {
    MeshScene scene;
    for (const PatchMesh* mesh : {&far, &near}) scene.others.push_back({mesh, Pose::Identity()});
    for (const Rays* some : rays) scene.rays.push_back({some, T_camera_sensor});
    return doctest::Approx(render_triangles(camera, scene, 1)[3 * 7 + 3]);
  };
  CHECK(middle({&met, &passed, &passed}) == 5);
  CHECK(middle({&passed, &met, &met}) == 10);
  // At two centimetres one ray is not sure but two are. Else the next rays are queried.
  CHECK(middle({&met_aside}) == 5);
  CHECK(middle({&met_aside, &passed}) == 10);
  CHECK(middle({&met_aside, &met_aside, &passed}) == 5);
  // At one centimetre one ray is sure of free space, and two are sure of a surface.
  const Rays met_close = sweep(5, spacing, 0.0085f), passed_close = sweep(10, spacing, 0.0085f);
  CHECK(middle({&passed_close, &met, &met}) == 10);
  CHECK(middle({&met_close, &passed}) == 10);
  CHECK(middle({&met_close, &met_close, &passed}) == 5);
}

TEST_CASE("an object goes on where rays met it close by, and other sweeps add what none denies") {
  const Camera camera{100, 100, 3, 3, 7, 7};
  const PatchMesh wall = square(10), dynamic_mesh = square(5);
  const float spacing = 0.5f;
  const Rays close = sweep(5, spacing, 0.06f), beside = sweep(5, spacing, 0.1f),
             far = sweep(5, spacing, 0.15f), passed = sweep(10, spacing, 0.005f),
             aside = sweep(10, spacing, 0.04f);
  const Pose T = looking_ahead();
  enum Kind { kTrusted, kOther, kContinued };
  const auto middle = [&](const std::vector<SweepRays>& rays, Kind kind) {
    MeshScene scene;
    scene.nearest.push_back({&wall, Pose::Identity()});
    const std::vector<PlacedMesh> meshes{{&dynamic_mesh, Pose::Identity()}}, none;
    scene.dynamic_objects.push_back({kind == kTrusted ? meshes : none,
                                     kind == kOther ? meshes : none,
                                     kind == kContinued ? meshes : none,
                                     rays,
                                     {0, 7, 0, 7}});
    return render_triangles(camera, scene, 1)[3 * 7 + 3];
  };
  const float shaky = 0.05f;
  CHECK(middle({{&beside, T}}, kContinued) == doctest::Approx(5));
  CHECK(std::isnan(middle({{&beside, T, shaky}}, kContinued)));  // it may have passed farther off
  CHECK(middle({{&beside, T, shaky}, {&beside, T, shaky}}, kContinued) == doctest::Approx(5));
  CHECK(std::isnan(middle({{&far, T}}, kContinued)));
  CHECK(std::isnan(middle({}, kContinued)));
  CHECK(middle({{&passed, T}}, kContinued) == doctest::Approx(10));
  CHECK(middle({{&passed, T, shaky}}, kContinued) == doctest::Approx(10));
  // No ray passed close, but those around did, in each quadrant.
  CHECK(middle({{&aside, T, shaky}}, kContinued) == doctest::Approx(10));
  CHECK(std::isnan(middle({{&aside, T, shaky, 2 * kShutter}}, kContinued)));  // long ago
  // One that passed four centimetres aside outweighs one that met six aside.
  CHECK(std::isnan(middle({{&close, T}, {&aside, T}}, kContinued)));
  // What another sweep measured takes more than one ray to doubt, and many to deny.
  CHECK(middle({}, kOther) == doctest::Approx(5));
  CHECK(middle({{&far, T}}, kOther) == doctest::Approx(5));
  const SweepRays denied{&passed, T, shaky}, confirmed{&close, T};
  CHECK(middle({denied}, kOther) == doctest::Approx(5));
  CHECK(std::isnan(middle({denied, denied}, kOther)));
  CHECK(std::isnan(middle({denied, denied, confirmed, confirmed, confirmed}, kOther)));
  CHECK(middle({confirmed, confirmed, denied, denied}, kOther) == doctest::Approx(5));
  CHECK(middle(std::vector<SweepRays>(7, denied), kOther) == doctest::Approx(10));
  for (const Rays* rays : {&close, &far, &passed}) CHECK(middle({{rays, T}}, kTrusted) == 5);
}

TEST_CASE("other sweeps only fill what the nearest mesh of an object left empty") {
  const Camera camera{100, 100, 3, 3, 7, 7};
  // The surface of the nearest sweep ends within the only tile, in the middle of the image.
  const PatchMesh wall = square(10), half = square(5, -5, 0.01f), nearer = square(4);
  const Rays met = sweep(4, 0.01f, 0), passed = sweep(10, 0.01f, 0);
  const Pose T = looking_ahead();
  for (const Rays* rays : {&met, &passed}) {
    MeshScene scene;
    scene.nearest.push_back({&wall, Pose::Identity()});
    scene.dynamic_objects.push_back({{{&half, Pose::Identity()}},
                                     {{&nearer, Pose::Identity()}},
                                     {},
                                     {{rays, T}},
                                     {0, 7, 0, 7}});
    const auto depth = render_triangles(camera, scene, 1);
    for (std::size_t i = 0; i < depth.size(); ++i)
      CHECK(depth[i] == doctest::Approx(i % 7 <= 3 ? 5 : rays == &met ? 4 : 10));
  }
}

using ObjectIndex = std::vector<std::uint16_t>;

TEST_CASE(
    "a discontinuity of an object is split near the middle, each side at the range of its "
    "corners") {
  Matrix points(3, 3);
  points << 10, 0, 0, 20, 1, 0, 20, 0, 1;
  const std::uint32_t triangle[1][3] = {{0, 1, 2}};
  const std::uint8_t whole = 0, cut = 1;
  CHECK(partition_mesh(points, triangle, &whole, 1, ObjectIndex{0, 0, 0}.data(), 1)
            .parts[0]
            .whole.size() == 1);

  // Of static surface the nearer side may hide the other one.
  const auto world = partition_mesh(points, triangle, &cut, 1, ObjectIndex{0, 0, 0}.data(), 1);
  CHECK(world.parts[0].whole.empty());
  CHECK(world.parts[0].inner.empty());
  REQUIRE(world.parts[0].outer.size() == 1);
  for (const auto corner : world.parts[0].outer[0])
    CHECK(world.vertices[corner].norm() == doctest::Approx(10));

  const auto split = partition_mesh(points, triangle, &cut, 1, ObjectIndex{1, 1, 1}.data(), 2);
  CHECK(split.parts[1].whole.empty());
  CHECK(split.parts[1].outer.empty());
  REQUIRE(split.parts[1].inner.size() == 3);
  for (const auto corner : split.parts[1].inner[0])
    CHECK(split.vertices[corner].norm() == doctest::Approx(10));
  for (const auto part : {1, 2})
    for (const auto corner : split.parts[1].inner[part])
      CHECK(split.vertices[corner].norm() > 19.9);

  // Two surfaces are never joined, with or without a jump.
  const auto border = partition_mesh(points, triangle, &whole, 1, ObjectIndex{0, 1, 0}.data(), 2);
  CHECK(border.parts[0].whole.empty());
  CHECK(border.parts[1].whole.empty());
  CHECK(border.parts[1].inner.empty());
  CHECK(border.parts[1].outer.size() == 1);
  CHECK(border.parts[0].outer.empty());
}

TEST_CASE("a steep triangle between jumps is no surface, and the end of a wall is") {
  // A wall along y = 1, and a point far behind its end.
  Matrix points(5, 3);
  points << 10, 1, 0, 10, 1, 0.2f, 16, 1, 0, 16, 1, 0.2f, 40, 2.3f, 0;
  const std::uint32_t triangles[3][3] = {{0, 1, 2}, {1, 3, 2}, {2, 3, 4}};
  const std::uint8_t end[3] = {0, 0, 1};
  CHECK(partition_mesh(points, triangles, end, 3, ObjectIndex(5, 0).data(), 1)
            .parts[0]
            .whole.size() == 2);
  const std::uint8_t both[3] = {1, 0, 1};  // jumps at corners 0, 1 and 2, and at 2, 3 and 4
  CHECK(partition_mesh(points, triangles, both, 3, ObjectIndex(5, 0).data(), 1)
            .parts[0]
            .whole.empty());
  CHECK(partition_mesh(points, triangles, both, 3, ObjectIndex(5, 1).data(), 2)
            .parts[1]
            .whole.size() == 1);  // few sweeps see an object that moves

  points.col(0).setConstant(10);  // what faces the sensor may be as narrow as a post
  CHECK(partition_mesh(points, triangles, both, 3, ObjectIndex(5, 0).data(), 1)
            .parts[0]
            .whole.size() == 1);
}

TEST_CASE("where two planes meet between their last returns, each goes on to the other") {
  // Seen from the origin: a floor 2 below, and a wall at x = 10 that stands on it.
  Matrix points(6, 3);
  points << 4, -1, -2, 4, 1, -2, 6, 0, -2, 10, -1, 0, 10, 1, 0, 10, 0, 1;
  const std::uint32_t triangles[4][3] = {{0, 1, 2}, {3, 4, 5}, {2, 3, 4}, {1, 2, 4}};
  const std::uint8_t cut[4] = {0, 0, 1, 1};
  const auto surface = partition_mesh(points, triangles, cut, 4, ObjectIndex(6, 1).data(), 2);
  CHECK(surface.parts[1].whole.size() == 2);
  REQUIRE(surface.parts[1].inner.size() == 6);
  for (const auto& part : surface.parts[1].inner)
    for (const auto corner : part) {
      const Eigen::Vector3f p = surface.vertices[corner];
      const bool on_floor = p.z() == doctest::Approx(-2), on_wall = p.x() == doctest::Approx(10);
      CHECK((on_floor || on_wall));
    }
}
