#include "docdepth/dynamics/moving_cubes.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "docdepth/geometry/parallel.hpp"

namespace docdepth {
namespace {

constexpr float kCube = 1.0f;   ///< edge of a cube [m]
constexpr double kNear = 0.3;   ///< sweeps so near in time are asked [s]
constexpr int kFewest = 3;      ///< places that move
constexpr float kShare = 0.6f;  ///< and more than that share of all places

struct Count {
  int moving = 0, standing = 0;
};

std::vector<std::uint64_t> cubes_of(std::size_t sweep,
                                    const std::vector<const Detections*>& sightings,
                                    const std::vector<double>& times,
                                    const std::vector<TrackingResult>& followed) {
  std::unordered_map<std::uint64_t, Count> counts;
  for (const bool moving : {true, false})
    for (std::size_t i = 0; i < times.size(); ++i) {
      if (i == sweep || std::fabs(times[i] - times[sweep]) > kNear + 1e-3) continue;
      const auto& rows = followed[i].objects;
      for (const Detection& object : *sightings[i]) {
        const bool moves =
            object.moves() || std::binary_search(rows.begin(), rows.end(), object.first);
        if (moves != moving) continue;
        for (const Eigen::Vector3f& place : object.places) {
          if (moving) {
            ++counts[cube_of(place)].moving;
          } else if (const auto found = counts.find(cube_of(place)); found != counts.end()) {
            ++found->second.standing;
          }
        }
      }
    }
  std::vector<std::uint64_t> cubes;
  for (const auto& [cube, count] : counts)
    if (count.moving >= kFewest &&
        float(count.moving) > kShare * float(count.moving + count.standing))
      cubes.push_back(cube);
  std::sort(cubes.begin(), cubes.end());
  return cubes;
}

}  // namespace

std::uint64_t cube_of(const Eigen::Vector3f& place) {
  return cube_key(cube_step(place.x(), kCube), cube_step(place.y(), kCube),
                  cube_step(place.z(), kCube));
}

std::vector<std::vector<std::uint64_t>> moving_cubes(
    const std::vector<const Detections*>& sightings, const std::vector<double>& times,
    const std::vector<TrackingResult>& followed, int threads) {
  std::vector<std::vector<std::uint64_t>> result(sightings.size());
  parallel_for(sightings.size(), 1, threads, [&](std::size_t i, std::size_t) {
    result[i] = cubes_of(i, sightings, times, followed);
  });
  return result;
}

}  // namespace docdepth
