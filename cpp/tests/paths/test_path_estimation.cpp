#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include "../objects.hpp"
#include "docdepth/paths/path_estimation.hpp"
#include "docdepth/paths/shifted_path.hpp"
#include "docdepth/paths/track_path.hpp"

using namespace docdepth;
using exact::pose_at;

namespace {

using Place = std::function<Pose(double)>;  ///< T_world_object at a time [s]

/// A track of a box, what each sweep saw of it, and the stamps.
struct Seen {
  Track track;
  std::vector<ObservedSurface> surfaces;
  std::vector<double> times;

  Seen(int count, const Place& place, float length, float width)
      : times(exact::stamps(std::size_t(count))) {
    for (int k = 0; k < count; ++k) {
      const TimedSurface box = exact::box(place(times[std::size_t(k)]), length, width);
      ObservedSurface surface;
      static_cast<TimedSurface&>(surface) = box;
      surfaces.push_back(surface);
      TrackObservation seen = observe(std::size_t(k), {exact::detection(box, 1)}, {0});
      const double now = 0.1 * k, before = 0.1 * (k - 1);
      if (k > 0)
        seen.shift = (place(now).translation() - place(before).translation()).cast<float>();
      track.observations.push_back(seen);
      ++track.transient_count;
    }
  }

  std::variant<Path, Cut> estimate() const { return estimate_path(track, surfaces, times); }
};

Place straight(double speed) {
  return [=](double t) { return pose_at(speed * t, 3); };
}

}  // namespace

TEST_CASE("by shifts alone, what moves heads along its way, and what stands has no known heading") {
  const Seen car(20, straight(10), 4.4f, 1.8f);
  const ShiftedPath driven = path_by_shifts(car.track, car.surfaces, car.times, {});
  REQUIRE(driven.path.states.size() == 20);
  REQUIRE(driven.headings.size() == 20);
  CHECK(driven.path.rigid);
  for (std::size_t k = 0; k < 20; ++k) {
    const PathState& state = driven.path.states[k];
    CHECK(state.velocity.x() == doctest::Approx(10).epsilon(0.02));
    CHECK(std::fabs(state.velocity.y()) < 0.1);
    CHECK(std::fabs(state.heading) < 0.02);
    CHECK(driven.headings[k].value == state.heading);
    CHECK(driven.headings[k].variance < 0.05);
  }
  const Seen parked(20, straight(0), 4.4f, 1.8f);
  const ShiftedPath standing = path_by_shifts(parked.track, parked.surfaces, parked.times, {});
  for (std::size_t k = 0; k < 20; ++k) {
    CHECK(std::isinf(standing.headings[k].variance));
    CHECK(standing.path.states[k].heading == standing.path.states[0].heading);
    CHECK(standing.path.states[k].velocity.norm() < 0.01);
  }
}

TEST_CASE("a car that drives straight on") {
  const auto found = Seen(20, straight(10), 4.4f, 1.8f).estimate();
  REQUIRE(std::holds_alternative<Path>(found));
  const Path& path = std::get<Path>(found);
  REQUIRE(path.states.size() == 20);
  CHECK(path.rigid);
  CHECK(path.has_ground);
  for (const PathState& state : path.states) {
    CHECK(state.velocity.x() == doctest::Approx(10).epsilon(0.02));
    CHECK(std::fabs(state.velocity.y()) < 0.1);
    CHECK(std::fabs(state.heading) < 0.02);
    // All states lie at one place of the car.
    CHECK(state.position.x() - 10 * state.time ==
          doctest::Approx(path.states[10].position.x() - 10).epsilon(0.03));
    CHECK(std::fabs(state.position.z()) < 0.05);  // the ground
    CHECK(state.surface_deviation < 0.1);
  }
  CHECK(path.extent.size().x() == doctest::Approx(4.4).epsilon(0.04));
  CHECK(path.extent.size().y() == doctest::Approx(1.8).epsilon(0.06));
}

TEST_CASE("a car that turns heads where it goes") {
  const double radius = 20, rate = 0.4;
  const auto found = Seen(
                         20,
                         [=](double t) {
                           return pose_at(radius * std::sin(rate * t),
                                          radius * (1 - std::cos(rate * t)), rate * t);
                         },
                         4.4f, 1.8f)
                         .estimate();
  REQUIRE(std::holds_alternative<Path>(found));
  for (const PathState& state : std::get<Path>(found).states) {
    CHECK(state.heading == doctest::Approx(rate * state.time).epsilon(0.03));
    CHECK(state.velocity.norm() == doctest::Approx(8).epsilon(0.03));
  }
}

TEST_CASE("a person is not rigid, and goes by the shifts") {
  const auto found = Seen(12, straight(1.5), 0.6f, 0.5f).estimate();
  REQUIRE(std::holds_alternative<Path>(found));
  const Path& path = std::get<Path>(found);
  CHECK(!path.rigid);
  CHECK(path.states[11].position.x() - path.states[0].position.x() ==
        doctest::Approx(1.5 * 1.1).epsilon(0.02));
  CHECK(path.states[6].velocity.x() == doctest::Approx(1.5).epsilon(0.03));
}

TEST_CASE("a track that goes on with something else is cut there") {
  const auto jumps = [](double t) { return pose_at(t < 0.95 ? 8 * t : 8 * t + 30, 3); };
  const auto found = Seen(20, jumps, 4.4f, 1.8f).estimate();
  REQUIRE(std::holds_alternative<Cut>(found));
  const Cut cut = std::get<Cut>(found);
  CHECK(((cut.begin == 0 && cut.end == 10) || (cut.begin == 10 && cut.end == 20)));
}

TEST_CASE("a car that stops stays there, though only its side is seen, which tells nothing of it") {
  Seen seen(24, [](double t) { return pose_at(std::min(10 * t, 10.0), 0); }, 4.4f, 1.8f);
  for (ObservedSurface& surface : seen.surfaces) {
    const ObservedSurface whole = std::exchange(surface, {});
    for (std::size_t i = 0; i < whole.points.size(); ++i)
      if (whole.normals[i].y() < -0.5f) surface.add(whole.points[i], whole.normals[i], 0);
  }
  const auto found = seen.estimate();
  REQUIRE(std::holds_alternative<Path>(found));
  const auto& states = std::get<Path>(found).states;
  CHECK(states[23].position.x() - states[0].position.x() == doctest::Approx(10).epsilon(0.05));
}

TEST_CASE("a roof and the ground tell the height, each as well as it is known") {
  const double rise = 0.02;  // of the surface, from sweep to sweep
  Seen seen(20, straight(10), 4.4f, 1.8f);
  for (int k = 0; k < 20; ++k) {
    ObservedSurface& surface = seen.surfaces[std::size_t(k)];
    exact::add_side(straight(10)(0.1 * k), {-2.2f, -0.9f, 1.6f}, {4.4f, 0, 0}, {0, 1.8f, 0},
                    {0, 0, 1}, surface);
    for (Eigen::Vector3f& point : surface.points) point.z() += float(rise * k);
    seen.track.observations[std::size_t(k)].ground = {0, 0.02f};
  }
  const auto found = seen.estimate();
  REQUIRE(std::holds_alternative<Path>(found));
  const double height = std::get<Path>(found).states[19].position.z();
  CHECK(height > 0.1 * 19 * rise);
  CHECK(height < 0.8 * 19 * rise);
}

TEST_CASE("a path between and beyond its observations") {
  Path path;
  path.states = {{.time = 1, .position = {0, 0, 0}, .velocity = {4, 0, 0}},
                 {.time = 2, .position = {4, 2, 0}, .velocity = {8, 0, 0}, .heading = 0.4}};
  path.extents = {{{-2, -1, 0}, {2, 1, 1.5f}}, {{-2, -1, 0}, {2.4f, 1, 1.5f}}};
  path.extent = {{-3, -1, 0}, {2, 1, 2}};
  const TrackPath track(path, {});
  CHECK((track.pose(1.25).translation() - Eigen::Vector3d(1, 0.5, 0)).norm() < 1e-9);
  CHECK(heading_of(track.pose(1.25)) == doctest::Approx(0.1));
  CHECK((track.pose(0.5).translation() - Eigen::Vector3d(-2, 0, 0)).norm() < 1e-9);
  CHECK((track.pose(2.5).translation() - Eigen::Vector3d(8, 2, 0)).norm() < 1e-9);
  CHECK(track.velocity(1.5).x() == doctest::Approx(6));
  CHECK(track.speed(9) == doctest::Approx(8));
  CHECK(track.covers(0.01));
  CHECK(!track.covers(-0.01));  // it moves, so it is lost after a second
  CHECK(track.covers(2.99));
  CHECK(!track.covers(3.01));
  const OrientedBox box = track.box(1);
  CHECK(box.half.x() == doctest::Approx(2));
  CHECK(box.contains({1.9f, 0.9f, 0.1f}, 0));
  CHECK(!box.contains({2.2f, 0, 0.1f}, 0.1f));
  CHECK(track.box(1.25).half.x() == doctest::Approx(2));  // as in the nearest sweep
  CHECK(track.whole_box(1).half.x() == doctest::Approx(2.5));
  CHECK(track.whole_box(1).middle().x() == doctest::Approx(-0.5));
}

TEST_CASE("a distance counts as far as it is sure") {
  Path path;
  for (int k = 0; k < 3; ++k)
    path.states.push_back({.time = 0.1 * k,
                           .position = {2.0 * k, 0, 5.0 * k},
                           .is_transient = k > 0,
                           .independent_deviation = 0.3});
  path.extents.assign(3, {{-1, -1, 0}, {1, 1, 1}});
  const TrackPath track(path, {});
  const double unsure = 2 * std::hypot(0.3, 0.3);
  CHECK(track.distance() == doctest::Approx(4 - unsure));
  CHECK(track.transient_distance() == doctest::Approx(2 - unsure));
}

TEST_CASE("a pose that does not lean sideways") {
  const Pose T = upright_pose({1, 2, 3}, 0.5, 0.2);
  const Eigen::Vector3d forward = T.linear().col(0);
  CHECK(std::atan2(forward.y(), forward.x()) == doctest::Approx(0.5));
  CHECK(std::asin(forward.z()) == doctest::Approx(0.2));
  CHECK(T.linear().col(1).z() == doctest::Approx(0));
}
