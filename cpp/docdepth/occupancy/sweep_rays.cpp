#include "docdepth/occupancy/sweep_rays.hpp"

#include <cmath>

#include "docdepth/geometry/key_numbers.hpp"

namespace docdepth {
namespace {

constexpr int kBits = 15;  ///< of a cell's number along an axis; farther cells share numbers

std::uint64_t key_of(const Eigen::Vector3f& point, std::uint16_t object, bool ground, double cell) {
  std::uint64_t key = std::uint64_t(object) << 1 | std::uint64_t(ground);
  for (int axis = 0; axis < 3; ++axis) {
    const auto number = static_cast<std::int64_t>(std::floor(point(axis) / cell));
    key = key << kBits | (std::uint64_t(number) & ((1u << kBits) - 1));
  }
  return key;
}

}  // namespace

std::vector<Ray> merge_rays(const Points& points, const Points& origins, const float* seconds,
                            const std::uint16_t* object, const bool* ground, double cell) {
  std::vector<Ray> rays;
  KeyNumbers numbers;
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const Eigen::Vector3f origin = origins.row(i), end = points.row(i);
    const std::uint32_t number = numbers[key_of(end, object[i], ground[i], cell)];
    if (number == rays.size())
      rays.push_back({origin, end, seconds[i], 1, object[i], ground[i]});
    else {
      Ray& ray = rays[number];
      ray.origin += origin, ray.end += end, ray.seconds += seconds[i], ++ray.count;
    }
  }
  for (Ray& ray : rays) {
    const float share = 1.0f / float(ray.count);
    ray.origin *= share, ray.end *= share, ray.seconds *= share;
  }
  return rays;
}

}  // namespace docdepth
