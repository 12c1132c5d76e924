#include "docdepth/mesh/directions.hpp"

#include "docdepth/geometry/simd.hpp"

namespace docdepth {
namespace {

struct FindDirections {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* points, std::size_t stride,
                                  Direction* __restrict directions) {
    for (std::size_t i = 0; i < count; ++i) {
      const float* p = points + stride * i;
      const float x = p[0], y = p[1], z = p[2];
      const float squared = (x * x + y * y) + z * z;
      const bool usable = squared > 0.0f && squared < kMaxRange * kMaxRange;  // false for NaN
      const Direction d = direction_of(usable ? x : 0.0f, usable ? y : 0.0f, usable ? z : 0.0f);
      directions[i].azimuth = d.azimuth;
      directions[i].elevation = d.elevation;
    }
  }
};

}  // namespace

std::vector<Direction> directions_of(const Points& points) {
  std::vector<Direction> directions(points.rows());
  dispatch<FindDirections>(directions.size(), points.data(),
                           static_cast<std::size_t>(points.outerStride()), directions.data());
  return directions;
}

}  // namespace docdepth
