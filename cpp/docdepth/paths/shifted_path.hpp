// Where a tracked object is by the shifts of its outlines alone.
#pragma once

#include <cmath>
#include <limits>
#include <span>
#include <vector>

#include "docdepth/paths/path_estimation.hpp"

namespace docdepth {

/// The heading of what moves, by its motion alone [rad].
struct MotionHeading {
  double value = 0, variance = std::numeric_limits<double>::infinity();
};

/// A path by shifts from sweep to sweep, without its extents.
struct ShiftedPath {
  Path path;
  std::vector<MotionHeading> headings;  ///< of each observation
};

/// The path of a track by the shifts from sweep to sweep, smoothed. Arguments as of estimate_path.
ShiftedPath path_by_shifts(const Track& track, std::span<const ObservedSurface> surfaces,
                           const std::vector<double>& times, const PathOptions& options);

/// How much a road user changes its acceleration in a second, by axis [m/s^2].
Eigen::Vector3d acceleration_change(const PathOptions& options);

/// The angle [rad] between -pi and pi.
inline double wrapped(double angle) {
  return std::remainder(angle, 2 * M_PI);
}

}  // namespace docdepth
