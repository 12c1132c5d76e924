// Constants of scan meshes. What a caller may vary is in MeshParameters (scan_mesh.hpp).
#pragma once

#include <cstdint>

namespace docdepth {

/// Larger ranges are no measurements [m]. Their squares fit a float.
constexpr float kMaxRange = 1e6f;

/// Sine of the smallest angle between a ray and a plane that is still believed: the road 80 m
/// ahead. A flatter plane joins the edge of an object to the background.
constexpr float kMinIncidenceSine = 0.02f;

// --- Directions: angles are counted in units, 65536 to a turn. ---

/// Units to a turn: 0.0055 degrees or 1 cm at 100 m. Fine enough to tell neighbouring returns
/// apart, coarse enough for exact 64-bit geometry.
constexpr std::int32_t kTurn = 65536;
constexpr float kRadiansPerUnit = 6.283185307179586f / kTurn;

// --- Delaunay triangulation of directions. ---

/// The cylinder of directions is unrolled onto a plane. Returns this near to the seam behind the
/// sensor are repeated beyond the other end [units].
constexpr std::int32_t kSeamOverlap = kTurn / 24;
/// Guard vertices stand this far out [units], one degree beyond the repeated returns.
constexpr std::int32_t kGuardAzimuth = kTurn / 2 + kSeamOverlap + kTurn / 360;
/// Strips of returns are this many times as high as evenly spread returns would be apart: about a
/// ring or two. Measured on HDL-64: half of it makes six times the flips, twice of it half as many
/// more.
constexpr double kStripHeight = 2.0;

}  // namespace docdepth
