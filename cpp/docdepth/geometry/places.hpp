// Where a thing is, as a few evenly spread points, and how far it went until it is seen again.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace docdepth {

using Places = std::vector<Eigen::Vector3f>;

/// From where to where something reaches along the axes.
struct Extent {
  Eigen::Vector3f low, high;

  Eigen::Vector3f size() const { return high - low; }
  float width() const { return size().head<2>().norm(); }  ///< from above
  void add(const Extent& other) {
    low = low.cwiseMin(other.low);
    high = high.cwiseMax(other.high);
  }
  bool overlaps(const Extent& other, float margin) const {
    return ((low.array() <= other.high.array() + margin) &&
            (other.low.array() <= high.array() + margin))
        .all();
  }
};

/// From where to where places reach; there is one at least.
Extent box_of(const Places& places);

/// Number of the cube of that size that holds a coordinate, and a key of three such numbers.
std::int64_t cube_step(float value, float size);
std::uint64_t cube_key(std::int64_t x, std::int64_t y, std::int64_t z = 0);

/// The mean of the points in each cube.
Places thinned(const Places& points, float size);

/// The same with larger cubes until there are `most` at the utmost.
Places thinned(const Places& points, float size, std::size_t most);

/// The horizontal shift up to `reach` that explains most of the differences b - a.
Eigen::Vector3f most_frequent_shift(const Places& a, const Places& b, float reach);

/// Move the shift to where the places of a fall onto the nearest of b; false when none are near.
bool refine_shift(const Places& a, const Places& b, Eigen::Vector3f& shift);

/// Share of the shifted places that have one of the others within `distance`.
float share_found(const Places& places, const Eigen::Vector3f& shift, const Places& in,
                  float distance = 0.3f);

}  // namespace docdepth
