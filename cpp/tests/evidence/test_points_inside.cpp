#include <doctest/doctest.h>

#include <memory>
#include <vector>

#include "docdepth/evidence/points_inside.hpp"

using namespace docdepth;

TEST_CASE("the window says which sweeps feed the dynamic voxels") {
  // Five sweeps at 5 Hz. Only the last one, 0.4 s after the middle one, saw a dynamic object.
  const SampledPoints samples(4, Eigen::Vector3f(0.5f, 0.5f, 0.5f));
  Detection seen;
  seen.points = seen.dynamic_points = 10;
  seen.area = seen.dynamic_area = 10;
  seen.box = extent_of(samples);
  seen.surface.points = samples;
  const Detections none, object{seen};
  std::vector<std::shared_ptr<const Detections>> detections;
  for (int i = 0; i < 5; ++i)
    detections.push_back(std::make_shared<const Detections>(i < 4 ? none : object));
  const std::vector<double> times{0, 0.2, 0.4, 0.6, 0.8};
  const std::vector<TrackedSweep> tracked(5);
  const auto voxels = [&](double window) {
    std::vector<std::size_t> counts;
    for (std::size_t i = 0; i < times.size(); ++i)
      counts.push_back(dynamic_voxels(i, 0, detections, times, tracked, window).size());
    return counts;
  };
  CHECK(voxels(0.3) == std::vector<std::size_t>{0, 0, 0, 1, 0});
  CHECK(voxels(0.6) == std::vector<std::size_t>{0, 1, 1, 1, 0});
  CHECK(voxels(0) == std::vector<std::size_t>{0, 0, 0, 0, 0});
  std::vector<std::size_t> counts;
  track_objects([&](std::size_t i) { return detections[i]; }, times, 1,
                [&](const TrackedSweep& sweep) { counts.push_back(sweep.voxels.size()); }, 2,
                {.window = 0.6});
  CHECK(counts == std::vector<std::size_t>{0, 1, 1, 1, 0});
}
