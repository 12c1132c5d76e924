// Points of surfaces, with normals.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Points of a sweep and their normals, of length 1; zero where the points do not tell the surface:
/// where they are too few, on a line, or above the sensor on a single ring.
struct OrientedPoints {
  std::vector<Eigen::Vector3f> points, normals;
};

/// Normals of the surfaces that points show: each that of the plane through the nearest points. It
/// needs no numbers of rings, so it serves sensors of all kinds. The result does not depend on the
/// number of threads.
/// @param points in the LiDAR frame, z up; finite, below 1e6 m
/// @param neighbors points of a plane, the point itself among them
OrientedPoints with_normals(const Points& points, int neighbors, int threads);

}  // namespace docdepth
