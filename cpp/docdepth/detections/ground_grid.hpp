// How high the ground is around an object. Road users stand on it, whatever is seen of them.
#pragma once

#include <cmath>
#include <limits>
#include <vector>

#include "docdepth/geometry/rigid.hpp"
#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// A height [m] and how wrong it may be [m]; infinite if nothing is known.
struct GroundHeight {
  float value = 0, deviation = std::numeric_limits<float>::infinity();

  bool is_known() const { return std::isfinite(deviation); }
};

/// The ground that one sweep saw, as mean heights of square cells around the LiDAR.
class GroundGrid {
 public:
  GroundGrid(const Points& points, const bool* ground, const RigidTransform& T_world_lidar);

  /// Under the middle of a box, from the plane through the ground around it: the nearer the more it
  /// counts, and as level as it can be.
  GroundHeight under(const Extent& box) const;

 private:
  struct Cell {
    float sum = 0;
    int points = 0;
  };
  int column(float coordinate, int axis) const;

  float corner_[2];  ///< of the first cell, in the world [m]
  float height_;     ///< of the LiDAR, from which cells count [m]
  std::vector<Cell> cells_;
};

}  // namespace docdepth
