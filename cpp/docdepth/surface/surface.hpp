// A sweep as the surface that it measured: voting asks it, rendering draws it.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

struct MeshParameters {
  float max_gap = 0.069813170f;  ///< longest side of a triangle, 4 deg from the sensor [rad]
  float jump_ratio = 4.0f;  ///< range difference over distance across the line of sight, of a jump
  float noise = 0.1f;       ///< smaller range differences are no jump [m]
  float flatness = 0.1f;    ///< returns that continue a plane this well are one surface [m]
};

/// Triangles between neighbouring returns of a sweep, whatever the sensor. Corners are rows of the
/// sweep's points, counterclockwise where azimuth is drawn to the right and elevation up.
struct ScanMesh {
  std::size_t points = 0;  ///< of the sweep
  std::vector<std::array<std::uint32_t, 3>> triangles;
  std::vector<std::uint8_t> discontinuity;  ///< of each triangle: 1 where it spans a depth jump
  std::vector<std::uint32_t> isolated;      ///< rows that no uncut triangle uses, ascending
};

/// Build the surface of a sweep. Points that are not finite or at the origin take no part, and are
/// not loose either. An edge is a depth jump when the range changes by more than `jump_ratio` times
/// the distance across the line of sight, unless the triangle goes on the plane of its neighbour:
/// that is how ground and walls at a grazing angle stay whole without being known as such.
ScanMesh build_scan_mesh(const Points& points, const MeshParameters& parameters);

}  // namespace docdepth
