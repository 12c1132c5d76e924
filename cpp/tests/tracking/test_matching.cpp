#include <doctest/doctest.h>

#include "../objects.hpp"
#include "docdepth/tracking/constants.hpp"
#include "docdepth/tracking/matching.hpp"

using namespace docdepth;
using exact::pose_at;

namespace {

using Rows = std::vector<std::uint32_t>;

TrackState state_of(const Detection& seen) {
  const TimedPoints samples{seen.samples(), seen.surface.times};
  TrackState state;
  state.samples = state.last = samples;
  state.largest = seen.box.size();
  return state;
}

/// The match of a car that stood at the origin with what is seen 0.1 s later.
Match match(const Detections& seen, const VelocityEstimate& velocity = {},
            std::vector<bool> free = {}) {
  TrackState state = state_of(exact::detection(exact::box(pose_at(0, 0)), 1));
  state.velocity = velocity;
  free.resize(seen.size(), true);
  return find_match(state, DetectionIndex(seen), [&](std::uint32_t k) { return free[k]; }, 0.1, {});
}

Detection car_at(double x, double y, float free = 1) {
  return exact::detection(exact::box(pose_at(x, y)), free);
}

VelocityEstimate velocity(float x) {
  VelocityEstimate known;
  known.add({0.1f * x, 0, 0}, 0.1, 0.02f);
  return known;
}

}  // namespace

TEST_CASE("the mean of the shifts tells the velocity, the last ones most") {
  VelocityEstimate known;
  CHECK(known.allows({100, 0, 0}, 0.1, 0));
  known.add({1, 0, 0}, 0.1, 0.1f);
  CHECK(known.mean.x() == doctest::Approx(10));
  CHECK(known.error == doctest::Approx(1));
  known.add({-2, 0, 0}, -0.1, 0.1f);  // backward in time
  CHECK(known.mean.x() == doctest::Approx(15));
  CHECK(known.error == doctest::Approx(1));
}

TEST_CASE("no road user changes its speed by more than it can") {
  const VelocityEstimate known = velocity(10);  // within 0.2 m/s
  for (const double dt : {0.5, -0.5}) {
    // 8 m/s^2 for half a second, the error of the velocity, and that of the shift.
    const float most = 8.0f * 0.25f / 2 + 0.2f * 0.5f + 0.15f;
    const auto allows = [&](float x, float y) {
      return known.allows({10 * float(dt) + x, y, 5}, dt, 0.15f);
    };
    CHECK(allows(most - 1e-3f, 0));
    CHECK(!allows(most + 1e-3f, 0));
    CHECK(!allows(-most - 1e-3f, 0));
    CHECK(!allows(0, most + 1e-3f));
  }
  CHECK(velocity(0.49f).stands());
  CHECK(!velocity(0.51f).stands());
}

TEST_CASE("an object goes on where its samples fall") {
  for (const auto& [x, y] : {std::pair(1.2, 0.3), std::pair(-2.0, 0.0), std::pair(0.4, -0.9)}) {
    const Match found = match({car_at(30, 9), car_at(x, y)});
    REQUIRE(found.detections == Rows{1});
    // Samples match exactly within 0.2 m, and of equal shifts the smaller one is taken.
    CHECK((found.shift - Eigen::Vector3f(float(x), float(y), 0)).norm() < 0.2f);
    CHECK(found.score > 0.8f);
    CHECK(!found.hidden);
    CHECK(found.largest.x() == doctest::Approx(4.4f));
  }
}

TEST_CASE("what may not be taken, or stands, is no continuation of what is not known to stand") {
  CHECK(match({car_at(1, 0)}, {}, {false}).score == 0);
  CHECK(match({car_at(1, 0, 0)}).score == 0);  // its place was never free
  CHECK(match({car_at(0.2, 0, 0)}, velocity(2)).detections == Rows{0});
  CHECK(match({car_at(9, 0)}).score == 0);  // 90 m/s
}

TEST_CASE("a track goes on about as fast as it went") {
  CHECK(match({car_at(1.15, 0)}, velocity(10)).detections == Rows{0});
  // A car elsewhere matches in part, but no faster than 8 m/s^2 and the errors allow.
  CHECK(match({car_at(2.0, 0)}, velocity(10)).shift.x() <= 1 + 0.04f + 0.02f + 0.15f + 1e-4f);
  // Of two, the one that is expected.
  const Match found = match({car_at(0.85, 0.6), car_at(1.0, 0)}, velocity(10));
  CHECK(found.shift.x() == doctest::Approx(1).epsilon(0.05));
}

TEST_CASE("samples are compared where they were at one time") {
  // The far half of the car was measured 50 ms later than the near one.
  Detection skewed = car_at(2, 0);
  float late = 0;
  for (std::size_t i = 0; i < skewed.surface.points.size(); ++i)
    if (skewed.surface.points[i].x() > 2) {
      skewed.surface.times[i] = 0.05f;
      skewed.surface.points[i].x() += 20 * 0.05f;
      late += 0.05f;
    }
  skewed.time_offset = late / float(skewed.surface.points.size());
  skewed.box = extent_of(skewed.surface.points);
  const Match found = match({skewed}, velocity(20));
  REQUIRE(found.detections == Rows{0});
  CHECK(found.shift.x() == doctest::Approx(2).epsilon(0.03));
}

TEST_CASE("together the parts are no larger than the object ever looked") {
  const Eigen::Vector3f size(4, 2, 1.5f);
  const auto could = [&](float x, float y, float z) {
    return could_match({{0, 0, 0}, {x, y, z}}, size);
  };
  CHECK(could(6.49f, 3.49f, 2.74f));
  CHECK(!could(6.51f, 1, 1));
  CHECK(!could(1, 3.51f, 1));
  CHECK(!could(1, 1, 2.76f));
}

TEST_CASE("a shift is known as well as rays are dense") {
  Detection far = exact::detection(exact::box(pose_at(1, 0)), 1, 60);
  CHECK(match({far}, velocity(10)).error == doctest::Approx(0.3f));
  CHECK(match({car_at(1, 0)}, velocity(10)).error == doctest::Approx(0.15f));
}

TEST_CASE("a small piece of what was seen is no continuation alone") {
  const auto score = [](float length) {
    TimedSurface side;
    exact::add_side(pose_at(0, 0), {-1, -0.9f, 0.2f}, {length, 0, 0}, {0, 0, 1.4f}, {0, -1, 0},
                    side);
    return match({exact::detection(side, 1)}, velocity(0)).score;
  };
  CHECK(score(2.6f) > 0);
  CHECK(score(0.2f) == 0);
}
