#include <doctest/doctest.h>

#include <algorithm>
#include <functional>

#include "../objects.hpp"
#include "docdepth/tracking/tracker.hpp"

using namespace docdepth;
using exact::pose_at;

namespace {

/// The tracks of what each sweep shows.
std::vector<Track> tracks(std::size_t count, const std::function<void(int, Detections&)>& show) {
  std::vector<Detections> sweeps(count);
  for (std::size_t k = 0; k < count; ++k) show(int(k), sweeps[k]);
  return follow_objects(exact::reader(sweeps), exact::stamps(count), {});
}

void add_car(Detections& seen, double x, double y = 0, float free = 1) {
  seen.push_back(exact::detection(exact::box(pose_at(x, y)), free));
}

std::vector<std::size_t> sweeps_of(const Track& track) {
  std::vector<std::size_t> sweeps;
  for (const TrackObservation& seen : track.observations) sweeps.push_back(seen.sweep);
  return sweeps;
}

float total_shift(const Track& track) {
  float sum = 0;
  for (const TrackObservation& seen : track.observations) sum += seen.shift.x();
  return sum;
}

}  // namespace

TEST_CASE("a car that moves is one track, and its shifts are its motion") {
  const auto found = tracks(8, [](int k, Detections& seen) { add_car(seen, 1.2 * k, 0.1 * k); });
  REQUIRE(found.size() == 1);
  const auto& observations = found[0].observations;
  REQUIRE(observations.size() == 8);
  CHECK(found[0].transient_count == 8);
  CHECK(observations[0].shift.isZero(0));
  for (std::size_t k = 1; k < 8; ++k) {
    CHECK(observations[k].sweep == k);
    CHECK((observations[k].shift - Eigen::Vector3f(1.2f, 0.1f, 0)).norm() < 0.06f);
    CHECK(observations[k].is_transient);
    CHECK(observations[k].points == 100);
  }
}

TEST_CASE("what never came nor went begins no track") {
  CHECK(tracks(6, [](int, Detections& seen) { add_car(seen, 9, 3, 0); }).empty());
}

TEST_CASE("a car that waits before it drives off, and after it came, is followed to there") {
  // It stands, speeds up by 5 m/s^2 for a second, brakes as hard and stands again.
  const auto place = [](int k) {
    const double t = std::clamp(0.1 * k - 0.8, 0.0, 2.0);
    return t < 1 ? 2.5 * t * t : 5 - 2.5 * (2 - t) * (2 - t);
  };
  const auto found = tracks(36, [&](int k, Detections& seen) {
    add_car(seen, place(k), 0, k > 8 && k < 28 ? 1.0f : 0.0f);
  });
  REQUIRE(found.size() == 1);
  REQUIRE(found[0].observations.size() == 36);
  CHECK(found[0].transient_count == 19);
  CHECK(found[0].observations[4].shift.norm() < 0.1f);
  CHECK(total_shift(found[0]) == doctest::Approx(5).epsilon(0.06));
}

TEST_CASE("two cars that meet are two tracks") {
  const auto found = tracks(10, [](int k, Detections& seen) {
    add_car(seen, 1.0 * k, 0);
    add_car(seen, 12 - 1.0 * k, 3.5);
  });
  REQUIRE(found.size() == 2);
  for (const Track& track : found) {
    REQUIRE(track.observations.size() == 10);
    const bool goes_on = track.observations[0].box.low.y() < 1;
    CHECK(total_shift(track) == doctest::Approx(goes_on ? 9 : -9).epsilon(0.06));
  }
}

TEST_CASE("where two tracks lead to one object, the longer one goes on with it") {
  const auto found = tracks(10, [](int k, Detections& seen) {
    add_car(seen, 1.0 * k);
    if (k == 5 || k == 6) add_car(seen, 7, 3.0 * (7 - k));
  });
  REQUIRE(found.size() == 2);
  CHECK(sweeps_of(found[0]).size() == 10);
  CHECK(sweeps_of(found[1]) == std::vector<std::size_t>{5, 6});
}

TEST_CASE("a car that is hidden for less than a second goes on, for longer it is lost") {
  const auto hidden = [](int sweeps) {
    return tracks(12 + std::size_t(sweeps), [sweeps](int k, Detections& seen) {
      if (k < 6 || k >= 6 + sweeps) add_car(seen, 1.0 * k);
    });
  };
  const auto one = hidden(9);  // 1.0 s from the last to the next
  REQUIRE(one.size() == 1);
  CHECK(one[0].observations.size() == 12);
  CHECK(one[0].observations[6].sweep == 15);
  CHECK(one[0].observations[6].shift.x() == doctest::Approx(10).epsilon(0.02));
  const auto two = hidden(10);
  REQUIRE(two.size() == 2);
  CHECK(sweeps_of(two[0]).size() == 6);
  CHECK(sweeps_of(two[1]).size() == 6);
}

TEST_CASE("what stands may stay hidden for five seconds") {
  const auto hidden = [](int sweeps) {
    return tracks(20 + std::size_t(sweeps), [sweeps](int k, Detections& seen) {
      const double x = k < 8 ? 0.4 * k : 0.4 * 7;
      if (k < 14 || k >= 14 + sweeps) add_car(seen, x, 0, 1);
    });
  };
  CHECK(hidden(49).size() == 1);
  CHECK(hidden(50).size() == 2);
}

TEST_CASE("what appears where something else stood already is not the track") {
  // A parked car is seen all the time; one that passes it disappears behind it for two sweeps.
  const auto found = tracks(10, [](int k, Detections& seen) {
    add_car(seen, 4, 0, 0);
    if (k < 4) add_car(seen, 1.0 * k - 4, 0);
  });
  REQUIRE(found.size() == 1);
  CHECK(sweeps_of(found[0]) == std::vector<std::size_t>{0, 1, 2, 3});
}

TEST_CASE("what is flat, or wider than any truck is long, is not tracked") {
  const auto moving = [](float length, float height) {
    return tracks(5, [=](int k, Detections& seen) {
      seen.push_back(exact::detection(exact::box(pose_at(1.0 * k, 0), length, 1.8f, height), 1));
    });
  };
  CHECK(moving(4.4f, 1.0f).size() == 1);
  CHECK(moving(4.4f, 0.1f).empty());
  CHECK(moving(26.0f, 1.0f).empty());
}

TEST_CASE("what was seen once and hidden is the beginning of the track that comes from there") {
  // Forward it is looked for in three sweeps only; backward the track knows where it was.
  const auto found = tracks(13, [](int k, Detections& seen) {
    if (k == 0 || k >= 6) add_car(seen, 1.0 * k);
  });
  REQUIRE(found.size() == 1);
  const auto& observations = found[0].observations;
  REQUIRE(sweeps_of(found[0]) == std::vector<std::size_t>{0, 6, 7, 8, 9, 10, 11, 12});
  CHECK(found[0].transient_count == 8);
  CHECK(observations[0].shift.isZero(0));
  CHECK(observations[1].shift.x() == doctest::Approx(6).epsilon(0.03));
  CHECK(observations[2].shift.x() == doctest::Approx(1).epsilon(0.1));  // within 0.2 m
}

TEST_CASE("a track does not begin with one that went elsewhere") {
  // The second car comes from where the first one was last, but that one drove the other way.
  const auto found = tracks(12, [](int k, Detections& seen) {
    if (k < 2) add_car(seen, 1.0 * k);
    if (k >= 5) add_car(seen, 2 - 1.0 * k);
  });
  REQUIRE(found.size() == 2);
  CHECK(total_shift(found[0]) == doctest::Approx(1).epsilon(0.1));  // within 0.2 m
  CHECK(total_shift(found[1]) == doctest::Approx(-6).epsilon(0.03));
}

TEST_CASE("of a car that is hidden in part all is kept that was seen of it") {
  const auto found = tracks(8, [](int k, Detections& seen) {
    const double middle = 0.5 * k;
    const TimedSurface whole = exact::box(pose_at(middle, 0));
    TimedSurface part;
    for (std::size_t i = 0; i < whole.points.size(); ++i) {
      const double x = whole.points[i].x() - middle;
      if (k < 3 || (k < 5 ? x > 0.3 : x < -0.3)) part.add(whole.points[i], whole.normals[i], 0);
    }
    const std::uint32_t points = k < 3 ? 100 : k == 4 ? 10 : 30;
    seen.push_back(exact::detection(part, 1, 10, points));
    if (k >= 3) seen.back().hidden.add({0.5f * float(k), -0.9f, 1}, 0);
  });
  REQUIRE(found.size() == 1);
  CHECK(found[0].observations.size() == 8);
}
