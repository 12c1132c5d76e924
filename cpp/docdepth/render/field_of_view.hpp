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
/// returns there is sky. The view of any other, such as those that draw rosettes, has no dents: it
/// is the convex hull of its returns. Gaps of its pattern are no ends of it.
class FieldOfView {
 public:
  /// If the origins of the rays are unknown, directions to near returns are off by the motion of
  /// the ego, so that these only tell how far down it looks.
  explicit FieldOfView(const Points& points, const Points* ray_origins);

  /// Whether the direction to a point lies inside.
  bool covers(const Eigen::Vector3f& point) const;

 private:
  std::vector<double> depth_below_, height_above_;  // elevations of each column [units]
};

}  // namespace docdepth
