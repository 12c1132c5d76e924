// Constants of scan meshes. What a caller may vary is in MeshParameters (scan_mesh.hpp).
#pragma once

#include <cstdint>

namespace docdepth {

/// Larger ranges are no measurements [m]. Their squares fit a float.
constexpr float kMaxRange = 1e6f;

/// Sine of the smallest angle between a ray and a plane that is still believed: the road 80 m
/// ahead. A flatter plane joins the edge of an object to the background.
constexpr float kMinIncidenceSine = 0.02f;

/// Units to a turn: 0.0055 degrees or 1 cm at 100 m. Fine enough to tell neighbouring returns
/// apart, coarse enough for exact 64-bit geometry.
constexpr std::int32_t kTurn = 65536;
constexpr float kRadiansPerUnit = 6.283185307179586f / kTurn;

}  // namespace docdepth
