// The directions that a sensor looks at during a sweep, as its returns tell.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"
#include "docdepth/mesh/constants.hpp"

namespace docdepth {

/// The field of view of a sweep.
///
/// A sensor that spins fires everywhere between its lowest and its highest ray, and where nothing
/// returns there is sky. Of other sensors, such as those that draw rosettes, only returns tell
/// where they looked.
class FieldOfView {
 public:
  FieldOfView() = default;
  /// If the origins of the rays are unknown, directions to near returns are off by the motion of
  /// the ego, so that only far ones tell where it looked.
  explicit FieldOfView(const Points& points, const Points* ray_origins);

  /// Whether the direction to a point lies inside.
  bool covers(const Eigen::Vector3f& point) const;

 private:
  std::int32_t low_ = kTurn, high_ = -kTurn;  // of a sensor that spins
  std::vector<std::uint8_t> looked_;          // at each cell; empty if the sensor spins
};

}  // namespace docdepth
