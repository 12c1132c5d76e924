// Constants of geometry: of sampled objects, which objects/ classifies and render/ draws, and of
// the nearest neighbour search.
#pragma once

#include <cstddef>
#include <cstdint>

namespace docdepth {

// --- Sampling: an object is kept as the mean points of small voxels. ---

/// Edge of a voxel [m], half of kMatchDistance.
constexpr float kSampleSpacing = 0.15f;
/// Larger objects get voxels this many times larger until their samples are few enough.
constexpr float kSampleSpacingGrowth = 1.3f;
/// Farther voxels share one index: beyond it integers would overflow.
constexpr std::int64_t kMaxVoxel = std::int64_t{1} << 40;
/// An object with fewer samples has no shape that could be matched.
constexpr std::size_t kMinSamples = 5;

// --- Matching: the shift between two observations of one object. ---

/// Edge of a bin of the histogram of shifts [m].
constexpr float kShiftBin = 0.2f;
/// Larger shifts are not looked for [m]: after a pause of the recording the histogram would fill
/// the memory.
constexpr float kMaxShift = 400.0f;
/// Two samples tell a shift if they were measured at least this share of the time between their
/// sweeps apart: over less, their distance is noise more than motion.
constexpr float kMinTimeShare = 0.3f;
/// Samples whose heights differ more, after the object rose with the ground, are not the same
/// place [m].
constexpr float kMaxHeightDifference = 0.2f;
/// A sample is matched by another one within this distance [m].
constexpr float kMatchDistance = 0.3f;
/// Search radii of the steps that refine a shift [m], from the error of a bin to kMatchDistance.
constexpr float kRefineRadii[] = {0.6f, 0.4f, 0.3f, 0.3f, 0.3f};
/// Two objects match if the product of their matched shares is at least this.
constexpr float kMinMatchedShare = 0.4f;

// --- Nearest neighbours ---

/// Points in a leaf of the tree: fewer make the tree deeper, more are compared in vain.
constexpr std::size_t kTreeLeafSize = 16;
/// Branches whose bound exceeds the least squared distance by less are searched, too.
constexpr float kBoundMargin = 1.00001f;
/// Queries that a thread takes at once.
constexpr std::size_t kQueryBlock = 1024;
/// Squares of larger coordinates overflow a float [m].
constexpr float kMaxCoordinate = 1e18f;

}  // namespace docdepth
