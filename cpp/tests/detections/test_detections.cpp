#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <vector>

#include "docdepth/detections/detections.hpp"
#include "docdepth/mesh/scan_mesh.hpp"

using namespace docdepth;

namespace {

/// Two boards above flat ground, as a scanner of 0.5 degrees sees them: at 8 m to the left and at
/// 12 m to the right, behind it a wall at 20 m.
struct Scan {
  Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> points;
  std::vector<std::uint8_t> ground, dynamic, free, porous;
  std::vector<std::int32_t> first, last;
  std::vector<float> times;
  ScanMesh mesh;
  std::vector<std::uint32_t> objects;

  Scan() {
    std::vector<Eigen::Vector3f> seen;
    for (int row = -24; row <= 6; ++row)
      for (int column = -60; column <= 60; ++column) {
        const float elevation = float(row) * 0.0087266f, azimuth = float(column) * 0.0087266f;
        const Eigen::Vector3f ray(1, std::tan(azimuth), std::tan(elevation));
        float x = 20;
        if (column >= 20 && column <= 40 && row >= -10 && row <= 2) x = 8;
        if (column >= -40 && column <= -20 && row >= -7 && row <= 2) x = 12;
        const bool low = -1.8f / ray.z() > 0 && -1.8f / ray.z() < x;
        seen.push_back((low ? -1.8f / ray.z() : x) * ray);
        ground.push_back(low);
        dynamic.push_back(x == 8 && !low && column > 30);
        free.push_back(x == 12 && !low);
        porous.push_back(x == 8 && !low && column > 35);
        first.push_back(x == 12 ? 7 : 0);
        last.push_back(x == 12 ? 30 + (column & 1) : 99);
        times.push_back(x == 8 ? 0.02f : -0.01f);
      }
    points.resize(Eigen::Index(seen.size()), 3);
    for (std::size_t i = 0; i < seen.size(); ++i) points.row(Eigen::Index(i)) = seen[i];
    mesh = build_scan_mesh(points, {});
    objects = cluster_objects(points, as_bool(ground), mesh);
  }

  static const bool* as_bool(const std::vector<std::uint8_t>& values) {
    return reinterpret_cast<const bool*>(values.data());
  }

  Detections detect(const Pose& T_world_lidar = Pose::Identity()) const {
    return detect_objects(points,
                          {as_bool(ground), objects.data(), as_bool(dynamic), as_bool(free),
                           as_bool(porous), first.data(), last.data(), times.data()},
                          mesh, T_world_lidar);
  }
};

/// Of a board by how far it is.
const Detection& board(const Detections& found, float x) {
  for (const Detection& object : found)
    if (std::fabs(object.middle.x() - x) < 0.1f) return object;
  FAIL("no board at " << x << " m");
  return found.front();
}

}  // namespace

TEST_CASE("each board is an object, with what is known of its points") {
  const Detections found = Scan().detect();
  REQUIRE(found.size() == 3);  // and the wall
  const Detection &near = board(found, 8), &far = board(found, 12);
  CHECK(near.points == 21 * 13);
  CHECK(near.dynamic_points == 10 * 13);
  CHECK(far.points == 21 * 10);
  CHECK(!near.is_dynamic());
  CHECK(!near.was_free());
  CHECK(far.was_free());
  CHECK(far.is_transient());
  CHECK(far.free_area == doctest::Approx(far.area));
  CHECK(near.dynamic_area / near.area == doctest::Approx(10 / 21.0).epsilon(0.05));
  CHECK(near.porous_area / near.area == doctest::Approx(5 / 21.0).epsilon(0.05));
  CHECK(far.porous_area == 0);
  CHECK(far.range() == doctest::Approx(12.6).epsilon(0.05));
  CHECK(near.time_offset == doctest::Approx(0.02f));
  CHECK(far.first_occupied == 7);
  CHECK(far.last_occupied == 30);
  CHECK(far.stands_until == 31);
  CHECK(near.ground.value == doctest::Approx(-1.8f).epsilon(0.02));
}

TEST_CASE("areas do not depend on how far an object is, numbers of points do") {
  const Detections found = Scan().detect();
  const Detection &near = board(found, 8), &far = board(found, 12);
  // Square metres over the solid angle between two rays.
  const float solid = 0.0087266f * 0.0087266f;
  const float width = 8 * (std::tan(40 * 0.0087266f) - std::tan(20 * 0.0087266f)) * 21 / 20;
  const float height = 8 * (std::tan(2 * 0.0087266f) + std::tan(10 * 0.0087266f)) * 13 / 12;
  CHECK(near.area * solid == doctest::Approx(width * height).epsilon(0.15));
  CHECK(near.area / float(near.points) < far.area / float(far.points));
}

TEST_CASE("normals look away from the LiDAR, and borders tell what is behind and in front") {
  const Detections found = Scan().detect();
  const Detection& near = board(found, 8);
  int known = 0;
  for (const Eigen::Vector3f& normal : near.surface.normals) {
    if (normal.isZero(0)) continue;
    ++known;
    CHECK(normal.x() > 0.95f);
  }
  CHECK(known > int(near.surface.normals.size()) / 2);
  CHECK(!near.edges.points.empty());  // the wall shows beside it
  CHECK(near.hidden.points.empty());
  CHECK(!board(found, 20).hidden.points.empty());
}

TEST_CASE("boxes, samples and normals are in the world, the middle is not") {
  Pose T = Pose::Identity();
  T.translate(Eigen::Vector3d(100, 50, 2));
  T.rotate(Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitZ()));
  const Scan scan;
  const Detections here = scan.detect(), there = scan.detect(T);
  REQUIRE(here.size() == there.size());
  for (std::size_t k = 0; k < here.size(); ++k) {
    CHECK((here[k].middle - there[k].middle).norm() < 1e-5f);
    CHECK(there[k].box.low.y() == doctest::Approx(50 + here[k].box.low.x()).epsilon(1e-4));
    CHECK(there[k].box.high.x() == doctest::Approx(100 - here[k].box.low.y()).epsilon(1e-4));
    CHECK(there[k].area == here[k].area);
  }
  CHECK(board(there, 8).ground.value == doctest::Approx(0.2f).epsilon(0.1));
  for (const Eigen::Vector3f& normal : board(there, 8).surface.normals)
    CHECK((normal.isZero(0) || normal.y() > 0.95f));
}

TEST_CASE("of porous things nothing counts as free") {
  Scan scan;
  const auto count_at = [&](float free_share) {
    const Detections found = scan.detect();
    return board(found, 12).free_area >= free_share * board(found, 12).area;
  };
  CHECK(count_at(0.99f));
  // More than a tenth of its returns are isolated.
  scan.mesh.isolated.clear();
  int left = 23;
  for (std::uint32_t i = 0; i < scan.free.size() && left > 0; ++i)
    if (scan.free[i]) scan.mesh.isolated.push_back(i), --left;
  CHECK(!count_at(0.01f));
}

TEST_CASE("what was free at some time nearly as a whole is here for a while, though not for long") {
  Scan scan;
  const auto is_transient_if_free_from = [&](int column) {
    for (std::size_t i = 0; i < scan.porous.size(); ++i)
      scan.porous[i] = scan.free[i] && int(i % 121) - 60 >= column;
    Scan in_turn = scan;
    std::fill(in_turn.free.begin(), in_turn.free.end(), std::uint8_t(0));
    return board(in_turn.detect(), 12).is_transient();
  };
  CHECK(is_transient_if_free_from(-40));   // of columns -40 to -20
  CHECK(is_transient_if_free_from(-39));   // 0.95 or more
  CHECK(!is_transient_if_free_from(-37));  // less than 0.86
}

TEST_CASE("what lies behind another along the ray is not connected") {
  // Two columns of returns at 20 m, the second so much farther and so far beside the first.
  const auto connected = [](float farther, float beside) {
    Eigen::Matrix<float, 4, 3, Eigen::RowMajor> points;
    points << 20, 0, 0, 20, 0, 0.1f, 20 + farther, beside, 0, 20 + farther, beside, 0.1f;
    ScanMesh mesh;
    mesh.points = 4;
    mesh.triangles = {{0, 1, 2}, {1, 2, 3}};
    mesh.discontinuity = {0, 0};
    const std::vector<std::uint8_t> ground(4);
    return cluster_objects(points, Scan::as_bool(ground), mesh)[2] == 0;
  };
  CHECK(connected(0.9f, 0.2f));        // the side of a lorry at 12.5 degrees
  CHECK_FALSE(connected(0.9f, 0.1f));  // at 6.3 degrees: people who walk in file
  CHECK(connected(0.2f, 0.01f));       // so near are the legs of one
  CHECK_FALSE(connected(0.9f, 0.6f));  // more than a twentieth of the range apart
}
