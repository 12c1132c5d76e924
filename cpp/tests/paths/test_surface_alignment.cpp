#include <doctest/doctest.h>

#include <cmath>

#include "../objects.hpp"
#include "docdepth/paths/surface_alignment.hpp"

using namespace docdepth;
using exact::pose_at;

namespace {

ObservedSurface observed(const TimedSurface& surface) {
  ObservedSurface seen;
  static_cast<TimedSurface&>(seen) = surface;
  return seen;
}

/// A car at the origin, rear and right side.
SurfaceModel model_of(const ObservedSurface& seen) {
  SurfaceModel model(0.1f);
  model.add(seen, Pose::Identity());
  return model;
}

ExpectedPose expected(double position, double heading) {
  return {Pose::Identity(), Eigen::Matrix3d::Identity() * position * position, heading * heading};
}

}  // namespace

TEST_CASE("a surface is moved onto the model, by its sides alone") {
  const SurfaceModel model = model_of(observed(exact::box(Pose::Identity())));
  for (const auto& [x, y, heading] :
       {std::tuple(0.15, -0.1, 0.03), std::tuple(-0.2, 0.15, -0.04), std::tuple(0.05, 0.2, 0.0)}) {
    const Pose T = pose_at(x, y, heading);
    const SurfaceAlignment found =
        align_surface(observed(exact::box(T)), model, expected(0.5, 0.1));
    CHECK((found.position - T.translation()).head<2>().norm() < 0.02);
    CHECK(std::fabs(found.heading - heading) < 0.005);
    CHECK((found.T_world_object.translation() - T.translation()).head<2>().norm() < 0.02);
    CHECK(found.share == 1);
    CHECK(found.covariance(0, 0) < 0.05 * 0.05);
    CHECK(found.covariance(1, 1) < 0.05 * 0.05);
    CHECK(found.heading_variance < 0.02 * 0.02);
  }
}

TEST_CASE("what is expected pulls, but not at what the surface says alone") {
  const SurfaceModel model = model_of(observed(exact::box(Pose::Identity())));
  const Pose T = pose_at(0.2, 0, 0);
  const SurfaceAlignment found =
      align_surface(observed(exact::box(T)), model, expected(0.01, 0.001));
  CHECK(found.T_world_object.translation().x() < 0.15);
  CHECK(found.T_world_object.translation().x() > 0.01);
  CHECK(std::fabs(found.position.x() - 0.2) < 0.02);
  const SurfaceAlignment turned =
      align_surface(observed(exact::box(pose_at(0, 0, 0.04))), model, expected(0.5, 0.003));
  CHECK(heading_of(turned.T_world_object) < 0.03);
  CHECK(heading_of(turned.T_world_object) > 0.001);
  CHECK(std::fabs(turned.heading - 0.04) < 0.003);
}

TEST_CASE("a flat side tells where it is across, not along") {
  TimedSurface side;
  exact::add_side(Pose::Identity(), {-2, -0.9f, 0.2f}, {4, 0, 0}, {0, 0, 1}, {0, -1, 0}, side);
  const SurfaceModel model = model_of(observed(side));
  TimedSurface moved = side;
  for (Eigen::Vector3f& p : moved.points) p += Eigen::Vector3f(0.1f, 0.1f, 0);
  const SurfaceAlignment found = align_surface(observed(moved), model, expected(0.5, 0.01));
  CHECK(std::fabs(found.position.y() - 0.1) < 0.01);
  CHECK(found.covariance(0, 0) > 20 * found.covariance(1, 1));
  CHECK(found.covariance(2, 2) > 50);  // and nothing of its height
}

TEST_CASE("sides that face away are no partners") {
  const SurfaceModel model = model_of(observed(exact::box(Pose::Identity())));
  TimedSurface turned = exact::box(Pose::Identity());
  for (Eigen::Vector3f& normal : turned.normals) normal = -normal;
  CHECK(align_surface(observed(turned), model, expected(0.1, 0.01)).share < 0.1f);
}

TEST_CASE("the ends of a side are known where the background shows beside them") {
  TimedSurface side;
  exact::add_side(Pose::Identity(), {-2.2f, -0.9f, 0.2f}, {4.4f, 0, 0}, {0, 0, 1}, {0, -1, 0},
                  side);
  ObservedSurface seen = observed(side);
  CHECK(!model_of(seen).ends().low);
  seen.edges.add({-2.2f, -0.9f, 0.5f}, 0);
  Ends ends = model_of(seen).ends();
  CHECK(ends.low.value_or(0) == doctest::Approx(-2.2f));
  CHECK(!ends.high);
  seen.edges.add({2.2f, -0.9f, 0.5f}, 0);
  ends = model_of(seen).ends();
  CHECK(ends.low.value_or(0) == doctest::Approx(-2.2f));
  CHECK(ends.high.value_or(0) == doctest::Approx(2.2f));
  seen.hidden.add({2.2f, -0.9f, 0.5f}, 0);  // something nearer hides the rest
  CHECK(!model_of(seen).ends().high);
}

TEST_CASE(
    "both ends of a side tell where it is along itself, if they are as far apart as expected") {
  const auto side = [](float low, float high) {
    TimedSurface surface;
    exact::add_side(Pose::Identity(), {low, -0.9f, 0.2f}, {high - low, 0, 0}, {0, 0, 1}, {0, -1, 0},
                    surface);
    ObservedSurface seen = observed(surface);
    for (const float end : {low, high}) seen.edges.add({end, -0.9f, 0.5f}, 0);
    return seen;
  };
  const SurfaceModel model = model_of(side(-2.2f, 2.2f));
  const SurfaceAlignment whole = align_surface(side(-1.9f, 2.5f), model, expected(1, 0.01));
  CHECK(std::fabs(whole.position.x() - 0.3) < 0.03);
  CHECK(whole.covariance(0, 0) < 0.1 * 0.1);
  // One metre is hidden behind something that leaves no trace: its high end is another one.
  const SurfaceAlignment piece = align_surface(side(-2.2f, 1.2f), model, expected(1, 0.01));
  CHECK(std::fabs(piece.position.x()) < 0.02);
  CHECK(piece.covariance(0, 0) > 0.2 * 0.2);
  CHECK(piece.covariance(0, 0) > 4 * whole.covariance(0, 0));
}

TEST_CASE("a model counts how many sweeps saw each place") {
  const ObservedSurface whole = observed(exact::box(Pose::Identity()));
  ObservedSurface rear = whole;
  rear.points.resize(20);
  rear.normals.resize(20);
  SurfaceModel model(0.1f);
  model.add(whole, Pose::Identity());
  const std::size_t places = model.surface().points.size();
  model.add(rear, Pose::Identity());
  CHECK(model.surface().points.size() == places);
  CHECK(model.hits()[0] == 2);
  CHECK(model.hits().back() == 1);
}

TEST_CASE("what moves while it is measured is brought to one time") {
  ObservedSurface seen = observed(exact::box(Pose::Identity()));
  for (std::size_t i = 0; i < seen.points.size(); ++i) {
    seen.times[i] = 0.05f;
    seen.points[i] += 0.05f * Eigen::Vector3f(20, -3, 0);
  }
  seen.edges.add({1, 0, 0}, -0.1f);
  const ObservedSurface still = seen.deskewed({20, -3, 0});
  const TimedSurface box = exact::box(Pose::Identity());
  for (std::size_t i = 0; i < box.points.size(); ++i)
    CHECK((still.points[i] - box.points[i]).norm() < 1e-5f);
  CHECK(still.times[0] == 0);
  CHECK((still.edges.points[0] - Eigen::Vector3f(3, -0.3f, 0)).norm() < 1e-5f);
}

TEST_CASE("normals of what moves between neighbouring measurements are fitted anew") {
  const Eigen::Vector3f velocity(0, 10, 0);
  const auto seen_late = [&](const TimedSurface& surface) {
    ObservedSurface seen = observed(surface);
    for (std::size_t i = 0; i < seen.points.size(); i += 2) {
      seen.times[i] = 0.05f;
      seen.points[i] += 0.05f * velocity;
      seen.normals[i] = Eigen::Vector3f(0.8f, -0.6f, 0);  // of a triangle across both times
    }
    return seen;
  };
  TimedSurface side, bush;
  exact::add_side(Pose::Identity(), {-2, 0, 0.2f}, {4, 0, 0}, {0, 0, 1}, {0, -1, 0}, side);
  for (const float y : {0.0f, 0.2f, 0.4f})
    exact::add_side(Pose::Identity(), {-0.4f, y, 0.2f}, {0.8f, 0, 0}, {0, 0, 0.8f}, {0, -1, 0},
                    bush);
  for (const Eigen::Vector3f& normal : seen_late(side).deskewed(velocity).normals)
    CHECK((normal - Eigen::Vector3f(0, -1, 0)).norm() < 1e-3f);
  // A bush has no plane but at its outside.
  const ObservedSurface still = seen_late(bush).deskewed(velocity);
  for (std::size_t i = 0; i < still.points.size(); ++i)
    if ((still.points[i] - Eigen::Vector3f(0, 0.2f, 0.6f)).norm() < 0.25f)
      CHECK(still.normals[i].isZero(0));
}
