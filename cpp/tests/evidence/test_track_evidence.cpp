#include <doctest/doctest.h>

#include "../objects.hpp"
#include "docdepth/evidence/track_evidence.hpp"

using namespace docdepth;
using exact::pose_at;

namespace {

constexpr std::size_t kSweeps = 60;

/// A car that stands at x = 0 for 2 s, goes to x = 10 within a second, and stands there. While it
/// goes its place is free before and after; of the places where it stands the votes tell `free`.
double place(double t, double distance = 10) {
  const double s = std::clamp(t - 2, 0.0, 1.0);
  return distance * (s < 0.5 ? 2 * s * s : 1 - 2 * (1 - s) * (1 - s));
}

ObjectTrack car(float free, double distance = 10, double hidden_until = 0, float width = 1.8f,
                float length = 4.4f) {
  Track track;
  Path path;
  path.rigid = width > 1.4f;
  path.extent = {{-length / 2, -width / 2, 0.2f}, {length / 2, width / 2, 1.6f}};
  for (std::size_t k = 0; k < kSweeps; ++k) {
    const double t = 0.1 * double(k);
    const bool moves = t > 2 && t < 3;
    TrackObservation seen;
    seen.sweep = k;
    seen.area = 10'000;
    seen.free_area = seen.transient_area = moves ? 10'000 : free * 10'000;
    seen.points = 100;
    seen.is_transient = moves;
    const double x = place(t, distance);
    seen.box = path.extent.moved({float(x), 0, 0});
    track.transient_count += moves;
    track.observations.push_back(seen);
    const double speed = moves ? (place(t + 0.01, distance) - place(t - 0.01, distance)) / 0.02 : 0;
    path.states.push_back({.time = t,
                           .position = {x, 0, 0},
                           .velocity = {speed, 0, 0},
                           .is_transient = moves && t > hidden_until});
    path.extents.push_back(path.extent);
  }
  return {track, TrackPath(path, {})};
}

TrackEvidence evidence(float free = 0.3f) {
  return {car(free), 1, exact::stamps(kSweeps), {}};
}

/// What a sweep shows at a place: occupied from one sweep to another, by the votes.
Detection seen_at(double x, double y, float free, int first = 0, int last = int(kSweeps)) {
  Detection object = exact::detection(exact::box(pose_at(x, y)), free);
  object.first_occupied = object.stands_since = first;
  object.last_occupied = object.stands_until = last;
  return object;
}

bool makes_dynamic(TrackEvidence of, double time, const Detection& object, bool is_member = true) {
  return of.makes_dynamic(time, object, is_member);
}

/// Whether something of the size of a car, or as thin as a fence, moves of which these shares are
/// porous, transient, and free before or after.
bool moves_if(float porous, float transient, float free, double distance = 10,
              double hidden_until = 0, float width = 1.8f, float length = 4.4f) {
  ObjectTrack object = car(0, distance, hidden_until, width, length);
  for (TrackObservation& seen : object.track.observations) {
    seen.porous_area = porous * seen.area;
    seen.transient_area = transient * seen.area;
    seen.free_area = free * seen.area;
  }
  return moves(object, exact::stamps(kSweeps), {});
}

/// Whether somebody moves who is seen in so many sweeps, at this speed, where most was free.
bool walks(std::size_t sweeps, double speed) {
  Track track;
  Path path;
  path.extent = {{-0.2f, -0.3f, 0}, {0.2f, 0.3f, 1.7f}};
  for (std::size_t k = 0; k < sweeps; ++k) {
    const double t = 0.1 * double(k);
    TrackObservation seen;
    seen.sweep = k;
    seen.box = path.extent;
    seen.area = 1000;
    seen.free_area = seen.transient_area = 770;
    seen.is_transient = true;
    ++track.transient_count;
    track.observations.push_back(seen);
    path.states.push_back({.time = t,
                           .position = {speed * t, 0, 0},
                           .velocity = {speed, 0, 0},
                           .is_transient = true});
    path.extents.push_back(path.extent);
  }
  return moves({track, TrackPath(path, {})}, exact::stamps(sweeps), {});
}

}  // namespace

TEST_CASE("somebody walks who is seen for half a second only") {
  CHECK(walks(7, 0.8));
  CHECK(walks(9, 0.6));
  CHECK_FALSE(walks(9, 0.45));   // 0.36 m in 0.8 s
  CHECK_FALSE(walks(25, 0.12));  // 0.29 m in 2.4 s: a bush
  CHECK_FALSE(walks(3, 1.2));    // 0.24 m
  CHECK(walks(3, 1.4));
}

TEST_CASE("what moves is not flat and porous, or goes far") {
  const auto fence_moves_if = [](float porous, float transient, float free) {
    return moves_if(porous, transient, free, 10, 0, 0.21f);
  };
  CHECK(fence_moves_if(0.02f, 0.6f, 0.2f));
  CHECK(fence_moves_if(0.32f, 0.6f, 0.2f));
  CHECK_FALSE(fence_moves_if(0.7f, 0.75f, 0.2f));            // pickets
  CHECK_FALSE(fence_moves_if(0.82f, 0.93f, 0.08f));          // a piece of a fence, by 128 beams
  CHECK_FALSE(fence_moves_if(0.45f, 0.44f, 0.17f));          // a fence of KITTI 0013
  CHECK_FALSE(moves_if(0.31f, 0.27f, 0.20f, 2, 0, 0.03f));   // a bar, by 16 beams
  CHECK(moves_if(0.02f, 0.6f, 0.2f, 10, 0, 0.03f));          // the side of a van
  CHECK(moves_if(0.34f, 0.97f, 0.49f, 60, 0, 0.19f, 1.1f));  // a strip of a car, by 16 beams
  CHECK_FALSE(moves_if(0.37f, 0.89f, 0.11f, 2.7, 0, 0.10f, 0.29f));  // of KITTI 0013
  // Somebody who walks in single file.
  CHECK(moves_if(0.45f, 0.62f, 0.48f, 2, 0, 0.33f, 0.6f));
  CHECK(moves_if(0.46f, 0.50f, 0.32f, 3.6, 0, 0.22f, 0.55f));  // a child of a school class
  CHECK(moves_if(0.64f, 0.39f, 0.17f, 1.8, 0, 0.20f, 0.41f));
  CHECK_FALSE(moves_if(0.56f, 0.64f, 0.27f, 4, 0, 0.45f));  // a fence of KITTI 0013, in 2.4 s
  CHECK_FALSE(moves_if(0.66f, 0.21f, 0.20f, 1.4, 0, 0.32f, 1.98f));  // another piece of it
  // Pieces of fences and hedges that are found neither free nor porous.
  CHECK_FALSE(moves_if(0.19f, 0.15f, 0.15f, 3.4, 0, 0.17f, 1.35f));
  CHECK_FALSE(moves_if(0.12f, 0.20f, 0.16f, 19, 0, 0.06f, 2.96f));
  CHECK(moves_if(0.66f, 0.55f, 0.11f, 20));       // a lorry with its trailer, several lengths on
  CHECK(moves_if(0.78f, 0.32f, 0.11f, 20, 2.5));  // its tractor, hidden at first
  CHECK_FALSE(moves_if(0.78f, 0.32f, 0.11f, 20, 2.85));  // hidden nearly all the way
  CHECK_FALSE(moves_if(0.94f, 0.02f, 0.0f, 20));         // a scaffold, by 128 beams
}

TEST_CASE("what moves goes through places that were free before or after") {
  const auto moves_if = [](float porous, float transient, float free, double distance) {
    return ::moves_if(porous, transient, free, distance, 0, 0.45f, 0.6f);
  };
  // A metre or more, where few of them were.
  CHECK(moves_if(0.6f, 0.28f, 0.22f, 3.7));        // somebody in single file, by 32 beams
  CHECK(moves_if(0.03f, 0.26f, 0.26f, 4.3));       // somebody at 60 to 88 m, by 64 beams
  CHECK_FALSE(moves_if(0.56f, 0.49f, 0.03f, 18));  // a fence and a wall behind it, by 16 beams
  CHECK_FALSE(moves_if(0.1f, 0.09f, 0.01f, 30));   // a hedge of KITTI 0013
  CHECK_FALSE(moves_if(0.05f, 0.23f, 0.23f, 29));  // the edge of a hedge, faster than anybody
  CHECK_FALSE(::moves_if(0.50f, 0.47f, 0.15f, 24, 0, 0.19f, 0.66f));  // slats of KITTI 0013
  CHECK(::moves_if(0.32f, 0.68f, 0.68f, 11, 0, 0.19f, 0.26f));        // a part of a cyclist
  // Half a metre, where most of them were.
  CHECK(moves_if(0.01f, 0.98f, 0.96f, 0.7));
  CHECK_FALSE(moves_if(0.01f, 0.98f, 0.4f, 0.7));
  CHECK_FALSE(moves_if(0.01f, 0.98f, 0.96f, 0.4));
}

TEST_CASE("somebody in single file moves where others were before and after") {
  const auto moves_if = [](float porous, float free, float width, double distance = 3) {
    return ::moves_if(porous, free, free, distance, 0, width, 0.6f);
  };
  CHECK(moves_if(0.80f, 0.05f, 0.64f));        // by 64 beams
  CHECK(moves_if(0.75f, 0.11f, 0.46f));        // by 16 beams
  CHECK_FALSE(moves_if(0.80f, 0.05f, 0.30f));  // a fence of KITTI 0013
  CHECK_FALSE(moves_if(0.65f, 0.05f, 0.64f));  // a hedge
  CHECK_FALSE(moves_if(0.80f, 0.05f, 0.64f, 0.9));
}

TEST_CASE("a car that moves at some time is known before and after, where it stands") {
  TrackEvidence of = evidence();
  CHECK(of.stands_before());
  CHECK(of.stands_after());
  CHECK(of.covers(-100));
  CHECK(of.covers(100));
  CHECK(of.number() == 1);
}

TEST_CASE("what was followed is dynamic where its place was free while the car was elsewhere") {
  CHECK(makes_dynamic(evidence(), 2.5, seen_at(place(2.5), 0, 1)));
  // It stands at its first place: occupied from the beginning, until it drives off.
  CHECK(makes_dynamic(evidence(), 1, seen_at(0, 0, 0.3f, 0, 21)));
  // Behind the place where the car stands at last something stands all the time.
  CHECK(!makes_dynamic(evidence(), 2.5, seen_at(place(2.5), 0, 0.3f, 0, int(kSweeps)), false));
}

TEST_CASE(
    "what was followed while it moves is dynamic where most of it was free, if only for a while") {
  const auto is_dynamic = [](double time, float porous, bool is_member = true) {
    // Half a metre of it was never seen before, as with legs behind a parked car.
    Detection seen = seen_at(place(time), 0.5, 0);
    seen.porous_area = porous * seen.area;
    return makes_dynamic(evidence(0), time, seen, is_member);
  };
  CHECK(is_dynamic(2.5, 0.6f));
  CHECK(!is_dynamic(2.5, 0.4f));
  CHECK(!is_dynamic(1, 0.6f));  // while it stands
  CHECK(!is_dynamic(2.5, 0.6f, false));
}

TEST_CASE("of somebody in single file a third was free at some time, if he lies in his box") {
  const auto is_dynamic = [](float porous, double y, float width = 0.6f) {
    const TrackEvidence of{car(0, 10, 0, width, 4), 1, exact::stamps(kSweeps), {}};
    Detection seen = exact::detection(exact::box(pose_at(place(2.5), y), 0.5, 0.5), 0);
    seen.porous_area = porous * seen.area;
    return makes_dynamic(of, 2.5, seen);
  };
  CHECK(is_dynamic(0.45f, 0));
  CHECK(!is_dynamic(0.3f, 0));
  CHECK(!is_dynamic(0.45f, 0.6));      // half of it lies beside him
  CHECK(!is_dynamic(0.45f, 0, 1.8f));  // within a vehicle
}

TEST_CASE("where a vehicle drives that goes several lengths, nothing stands") {
  const auto is_dynamic = [](double time, double x, double y) {
    const TrackEvidence of{car(0, 20), 1, exact::stamps(kSweeps), {}};
    return makes_dynamic(of, time, seen_at(x, y, 0), false);
  };
  CHECK(is_dynamic(2.5, place(2.5, 20), 0));
  CHECK(!is_dynamic(2.5, place(2.5, 20), 0.5));  // half a metre beside it
  CHECK(!is_dynamic(4, 20, 0));                  // where it stands: votes must tell
  CHECK(!makes_dynamic(evidence(0), 2.5, seen_at(place(2.5), 0, 0)));
}

TEST_CASE("what a track was not followed through must lie in its box, and have been free") {
  CHECK(makes_dynamic(evidence(), 1, seen_at(0, 0, 0.3f, 0, 21), false));
  CHECK(!makes_dynamic(evidence(), 1, seen_at(0, 3, 0.3f, 0, 21), false));    // beside it
  CHECK(!makes_dynamic(evidence(), 1, seen_at(10, 0, 0.3f, 30, 60), false));  // where it goes later
  CHECK(makes_dynamic(evidence(), 5, seen_at(10, 0, 0.3f, 28, 60), false));
  CHECK(!makes_dynamic(evidence(), 5, seen_at(0, 0, 0.3f, 0, 60), false));  // where it was before
}

TEST_CASE("a sign above the street that a car starts from is none of the car") {
  const TrackEvidence of{car(0.3f, 3), 1, exact::stamps(kSweeps), {}};
  // There all the time, as the car is.
  Detection seen = seen_at(place(2.5, 3), 0, 0, 0, int(kSweeps) - 1);
  CHECK(makes_dynamic(of, 2.5, seen));
  const Eigen::Vector3f up(0, 0, 2.5f);
  seen.box = seen.box.moved(up);
  for (Eigen::Vector3f& sample : seen.surface.points) sample += up;
  CHECK(!makes_dynamic(of, 2.5, seen));
}

TEST_CASE("what is dynamic already is left as it is") {
  Detection known = seen_at(place(2.5), 0, 1);
  known.dynamic_points = known.points;
  CHECK(!makes_dynamic(evidence(), 2.5, known));
}

TEST_CASE("a track makes no more dynamic than was ever seen of it") {
  // In all sweeps together 9 x 10,000.
  Detection large = seen_at(place(2.5), 0, 1);
  large.area = large.free_area = 89'000;
  CHECK(makes_dynamic(evidence(0), 2.5, large));
  large.area = large.free_area = 91'000;
  CHECK(!makes_dynamic(evidence(0), 2.5, large));
}

TEST_CASE("a parked car beside the one that arrives is apart from it") {
  const TrackEvidence of = evidence();
  const Detection best = seen_at(10, 0, 0.6f);
  CHECK(of.are_apart(4, seen_at(10, 2.4, 0), best));
  CHECK(!of.are_apart(4, seen_at(10, 1.0, 0), best));     // together as wide as one
  CHECK(!of.are_apart(4, seen_at(10, 2.4, 0.5f), best));  // as free
  CHECK(!of.are_apart(4, seen_at(15, 0, 0), best));       // behind it
}
