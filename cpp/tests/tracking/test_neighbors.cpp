#include <doctest/doctest.h>

#include <cmath>
#include <vector>

#include "docdepth/tracking/neighbors.hpp"

using namespace docdepth;

namespace {

/// The outline of a box on the ground, turned about the origin.
SampledPoints outline(float x, float y, float length, float width, double turn = 0) {
  const Eigen::Matrix3f rotation =
      Eigen::AngleAxisf(float(turn), Eigen::Vector3f::UnitZ()).toRotationMatrix();
  SampledPoints samples;
  for (float s = -0.5f; s <= 0.5f; s += 0.05f)
    for (const float side : {-0.5f, 0.5f}) {
      samples.push_back(rotation * Eigen::Vector3f(x + s * length, y + side * width, 0.5f));
      samples.push_back(rotation * Eigen::Vector3f(x + side * length, y + s * width, 0.5f));
    }
  return samples;
}

/// A detection at 10 m, of which so large a share was free, and when its place was occupied.
Detection detection(SampledPoints samples, std::uint32_t points, float free, int first, int last) {
  Detection object;
  object.points = points;
  object.area = 100.0f * float(points);
  object.free_area = free * object.area;
  object.first_occupied = first;
  object.last_occupied = last;
  object.surface.points = std::move(samples);
  return object;
}

std::vector<std::uint32_t> kept(const Detections& seen) {
  std::vector<std::uint32_t> objects;
  for (std::uint32_t k = 0; k < seen.size(); ++k) objects.push_back(k);
  drop_neighbors(seen, objects);
  return objects;
}

using Rows = std::vector<std::uint32_t>;

}  // namespace

TEST_CASE("what was there before an object came is a neighbor") {
  const SampledPoints car = outline(0, 0, 4.4f, 1.8f), behind = outline(5, 0, 4.4f, 1.8f);
  const Detection arrived = detection(car, 90, 0.25f, 25, 130);
  const auto with = [&](std::uint32_t points, float free, int first, int last) {
    return kept({detection(behind, points, free, first, last), arrived});
  };
  CHECK(with(100, 0.02f, 5, 130) == Rows{1});
  CHECK(with(100, 0.02f, 25, 149) == Rows{1});     // it stays
  CHECK(with(100, 0.02f, 30, 130) == Rows{0, 1});  // a part that was not looked at before
  CHECK(with(100, 0.2f, 5, 130) == Rows{0, 1});    // as free
  // What was mostly free tells it alone.
  CHECK(kept({detection(behind, 100, 0.1f, 25, 130), detection(car, 90, 0.6f, 25, 130)}) ==
        Rows{1});
}

TEST_CASE("two cars side by side are wider than a vehicle, whichever way they are turned") {
  for (const double turn : {0.0, 0.3, 1.0, 1.57, 2.5}) {
    const auto both = [&](float x, float y, float length) {
      return kept({detection(outline(x, y, length, 1.8f, turn), 90, 0, 25, 130),
                   detection(outline(0, 0, length, 1.8f, turn), 90, 0.02f, 25, 130)});
    };
    CHECK(both(0, 2.3f, 4.4f) == Rows{1});
    CHECK(both(0, 1.0f, 4.4f) == Rows{0, 1});  // 2.8 m together
    CHECK(both(9, 0, 8.0f) == Rows{0, 1});     // a lorry and its trailer
  }
}

TEST_CASE("what was told apart is found again at its place") {
  const SampledPoints parked = outline(5, 0, 4.4f, 1.8f);
  Detections seen{detection(parked, 100, 0, 5, 149),
                  detection(outline(0, 0, 4.4f, 1.8f), 90, 0.25f, 25, 130)};
  std::vector<std::uint32_t> objects{0, 1};
  const SampledPoints neighbors = drop_neighbors(seen, objects);
  CHECK(neighbors.size() == parked.size());
  CHECK(is_among(seen[0], neighbors));
  CHECK(!is_among(seen[1], neighbors));
  CHECK(!is_among(seen[0], {}));
}
