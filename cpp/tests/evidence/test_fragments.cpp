#include <doctest/doctest.h>

#include "../objects.hpp"
#include "docdepth/evidence/fragments.hpp"

using namespace docdepth;

namespace {

/// An object that goes along x, seen in some sweeps; `size` is its length, width and height.
ObjectTrack object(double x, double y, double speed, const Eigen::Vector3f& size, float area,
                   std::size_t first = 0, std::size_t count = 10) {
  Track track;
  Path path;
  path.rigid = true;
  const Extent box{{-size.x() / 2, -size.y() / 2, 0}, {size.x() / 2, size.y() / 2, size.z()}};
  path.extent = box;
  for (std::size_t k = first; k < first + count; ++k) {
    const double time = 0.1 * double(k);
    const Eigen::Vector3d at(x + speed * time, y, 0);
    TrackObservation seen;
    seen.sweep = k;
    seen.detections = {std::uint32_t(k)};
    seen.box = box.moved(at.cast<float>());
    seen.area = area;
    seen.free_area = seen.transient_area = area;
    seen.points = std::uint32_t(area / 100);
    seen.is_transient = true;
    track.observations.push_back(seen);
    ++track.transient_count;
    path.states.push_back({.time = time, .position = at, .velocity = {speed, 0, 0}});
    path.extents.push_back(box);
  }
  return {track, TrackPath(path, {})};
}

const Eigen::Vector3f kCar(4.4f, 1.8f, 1.5f), kPiece(0.6f, 0.4f, 1);

/// How many tracks are merged where a car at the origin and something else are seen.
std::size_t merged(const ObjectTrack& other, double car_speed = 10) {
  std::vector<ObjectTrack> objects{object(0, 0, car_speed, kCar, 10'000), other};
  const auto found = merge_fragments(objects, exact::stamps(30), {});
  CHECK(objects.size() == (found.empty() ? 2 : 0));
  return found.size();
}

}  // namespace

TEST_CASE("what touches a vehicle all the while is a fragment of it") {
  CHECK(merged(object(1, 0.5, 10, kPiece, 500)) == 1);
  CHECK(merged(object(2.3, 0, 10, kPiece, 500)) == 1);
  CHECK(merged(object(6, 0, 10, kPiece, 500)) == 0);    // ahead of it
  CHECK(merged(object(1, 3.0, 10, kPiece, 500)) == 0);  // beside it
  CHECK(merged(object(2.0, 0, 8, kPiece, 500)) == 1);   // few returns tell little of its speed
  CHECK(merged(object(4.5, 0, 0, kPiece, 500)) == 0);   // it drives past
}

TEST_CASE("beside a side, close enough for both to be one vehicle") {
  const auto beside = [](double gap) {
    return merged(object(1, 0.9 + 0.2 + gap, 10, kPiece, 500));
  };
  CHECK(beside(0.2) == 1);
  CHECK(beside(0.3) == 0);
}

TEST_CASE("too few sweeps in common tell nothing") {
  CHECK(merged(object(1, 0.5, 10, kPiece, 500, 0, 2)) == 0);
  CHECK(merged(object(1, 0.5, 10, kPiece, 500, 0, 3)) == 1);
}

TEST_CASE("nothing is a fragment of something small") {
  std::vector<ObjectTrack> people{object(0, 0, 1, {0.4f, 0.5f, 1.7f}, 2000),
                                  object(0.2, 0, 1, {0.3f, 0.3f, 1}, 500)};
  CHECK(merge_fragments(people, exact::stamps(10), {}).empty());
}

TEST_CASE("a merged track has what each sweep saw of all its fragments") {
  std::vector<ObjectTrack> objects{object(0, 0, 10, kCar, 9'000),
                                   object(1, 0.5, 10, kPiece, 1'000, 5, 10)};
  const auto found = merge_fragments(objects, exact::stamps(30), {});
  REQUIRE(found.size() == 1);
  const auto& observations = found[0].observations;
  REQUIRE(observations.size() == 15);
  CHECK(found[0].transient_count == 15);
  CHECK(observations[4].area == 9'000);
  CHECK(observations[7].area == 10'000);
  CHECK(observations[7].points == 100);
  CHECK(observations[7].detections.size() == 2);
  CHECK(observations[12].area == 1'000);
  for (std::size_t k = 1; k < 15; ++k) {
    CHECK(observations[k].sweep == k);
    CHECK((observations[k].shift - Eigen::Vector3f(1, 0, 0)).norm() < 1e-4f);
  }
}
