// Constants that several folders share: of objects as samples, and of coordinates.
#pragma once

#include <cstddef>
#include <cstdint>

namespace docdepth {

/// Edge of a voxel [m], half of kMatchDistance.
constexpr float kSampleSpacing = 0.15f;
/// Larger objects get voxels this many times larger until their samples are few enough.
constexpr float kSampleSpacingGrowth = 1.3f;

/// Two samples tell a shift if they were measured at least this share of the time between their
/// sweeps apart: over less, their distance is noise more than motion.
constexpr float kMinTimeShare = 0.3f;
/// A sample is matched by another one within this distance [m].
constexpr float kMatchDistance = 0.3f;

/// Squares of larger coordinates overflow a float [m].
constexpr float kMaxCoordinate = 1e18f;

}  // namespace docdepth
