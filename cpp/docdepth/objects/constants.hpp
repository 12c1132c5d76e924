// Constants of objects. What a caller may vary is in ObjectParameters and TrackParameters; how
// objects are sampled and matched is in geometry/constants.hpp.
#pragma once

#include <cstddef>
#include <cstdint>

namespace docdepth {

// --- Objects of a sweep ---

/// Fewer connected points are no object: their returns are isolated.
constexpr std::uint32_t kMinDetectionPoints = 5;
/// Pieces of fewer points are also connected across discontinuities, up to this share of their
/// range [m/m].
constexpr float kPieceDistanceGrowth = 0.03f;
/// Wider objects are no road users [m]: longer than any truck, they only occupy space.
constexpr float kMaxObjectWidth = 25.0f;
/// Isolated points this near to a dynamic object belong to it [m].
constexpr float kObjectMargin = 0.2f;
/// An object is kept as at most this many samples.
constexpr std::size_t kMaxSamples = 100;
/// Spacing of the samples of objects wider than kMaxObjectWidth [m].
constexpr float kWideSampleSpacing = 0.25f;

// --- Tracking ---

/// Flatter objects are ground that the ground growing missed [m].
constexpr float kMinTrackedHeight = 0.15f;
/// Narrower objects are static [m]: poles.
constexpr float kMinTrackedWidth = 0.3f;
/// An object is searched this far around its predicted box [m].
constexpr float kSearchMargin = 0.5f;
/// Share of an object's samples that have to match the track it belongs to.
constexpr float kMinMemberShare = 0.6f;
/// Share of min_distance that a track goes while votes call it dynamic.
constexpr float kMinVotedDistanceShare = 0.3f;
/// Below this speed key frames near in time saw the object at its place [m/s].
constexpr float kSlow = 2;
/// Slower objects stand; they may stay hidden for long [m/s].
constexpr float kStanding = 0.5f;

// --- Motion of a track ---

/// One object never looks larger than its size times the factor, plus the margin [m].
constexpr float kMaxSizeFactor = 1.5f, kMaxSizeMargin = 0.5f;
/// A velocity is the mean of this many pairs of observations before and after.
constexpr std::size_t kVelocityPairs = 3;
/// The box of a standing object is collected over this many times the window.
constexpr double kStandingWindowFactor = 3;
/// A track supports as many static points as it had dynamic points in one sweep, or as in all
/// sweeps together divided by this.
constexpr std::size_t kTotalSupportDivisor = 8;

// --- Whether a place was free while the object was elsewhere ---

/// Samples farther from the box of the object are outside of it [m].
constexpr float kOutsideMargin = 0.1f;
/// An observation is elsewhere if this share of the samples lies outside of its box.
constexpr float kMinOutsideShare = 0.7f;
/// A sample is occupied by a static object within this distance [m].
constexpr float kOccupiedDistance = 0.25f;
/// A place is occupied if this share of its samples is.
constexpr float kMinOccupiedShare = 0.4f;
/// Every second observation is tested, and at most ten.
constexpr std::size_t kFreeTestStride = 2, kMaxFreeTests = 10;

// --- Dynamic voxels ---

/// Edge of a voxel [m].
constexpr float kDynamicVoxelSize = 1.0f;
/// A dynamic voxel has at least this many dynamic samples,
constexpr int kMinDynamicSamples = 3;
/// and they are more than this share of its samples.
constexpr float kMinDynamicSampleShare = 0.6f;

// --- Time ---

/// Stamps may be off by this without changing which sweeps lie within a window [s].
constexpr double kTimeTolerance = 1e-3;

}  // namespace docdepth
