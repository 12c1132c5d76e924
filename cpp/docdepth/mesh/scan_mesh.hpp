// A sweep as a mesh: triangles between neighbouring returns. Voting queries it, rendering draws it.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

struct MeshParameters {
  /// Longest side of a triangle as seen from the sensor [rad]: 4 degrees.
  float max_gap = 0.06981317f;
  /// A side is a discontinuity if the range changes by this many times the distance across the ray.
  float jump_ratio = 4.0f;
  /// The same of a triangle across missing returns: nothing was seen of what is between.
  float gap_jump_ratio = 1.0f;
  /// Smaller changes of range are never a discontinuity [m]: noise and rough surfaces.
  float noise = 0.1f;
  /// A triangle within this distance of its neighbour's plane is no discontinuity [m].
  float flatness = 0.1f;
};

/// Triangles between neighbouring returns of a sweep of any sensor.
struct ScanMesh {
  std::size_t points = 0;  ///< rows of the sweep
  /// Rows of the corners, counterclockwise where azimuth is drawn to the right and elevation up.
  std::vector<std::array<std::uint32_t, 3>> triangles;
  std::vector<std::uint8_t> discontinuity;  ///< 1 for each triangle that spans a depth jump
  std::vector<std::uint32_t> isolated;      ///< rows that no continuous triangle uses, ascending
};

/// Triangulate a sweep.
///
/// Points that are not finite or lie at the origin take no part and are not isolated either. A
/// triangle is a discontinuity if the range changes by more than `jump_ratio` times the distance
/// across the ray, unless it continues the plane of a neighbour. So ground and walls seen at a
/// grazing angle stay whole without a label.
ScanMesh build_scan_mesh(const Points& points, const MeshParameters& parameters);

}  // namespace docdepth
