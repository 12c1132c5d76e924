// Constants of sampled objects, shared by objects/ (which classifies them) and render/ (which draws
// them where they were at the time of an image).
#pragma once

#include <cstddef>

namespace docdepth {

// --- Sampling: an object is kept as the mean points of small voxels. ---

/// Edge of a voxel [m], half of kMatchDistance.
constexpr float kSampleSpacing = 0.15f;
/// Larger objects get voxels this many times larger until their samples are few enough.
constexpr float kSampleSpacingGrowth = 1.3f;
/// An object with fewer samples has no shape that could be matched.
constexpr std::size_t kMinSamples = 5;

// --- Matching: the horizontal shift between two sightings of one object. ---

/// Edge of a bin of the histogram of shifts [m].
constexpr float kShiftBin = 0.2f;
/// Samples whose heights differ more are not the same place [m]: objects move on the ground.
constexpr float kMaxHeightDifference = 0.2f;
/// A sample is matched by another one within this distance [m].
constexpr float kMatchDistance = 0.3f;
/// Search radii of the steps that refine a shift [m], from the error of a bin to kMatchDistance.
constexpr float kRefineRadii[] = {0.6f, 0.4f, 0.3f, 0.3f, 0.3f};
/// Two objects match if the product of their matched shares is at least this.
constexpr float kMinMatchedShare = 0.4f;

}  // namespace docdepth
