// Constants that tracking, paths and evidence share.
#pragma once

namespace docdepth {

/// Stamps may be off by this without changing which sweeps lie within a window [s].
constexpr double kTimeTolerance = 1e-3;
/// Flatter objects are ground that the ground growing missed [m].
constexpr float kMinTrackedHeight = 0.15f;
/// An object is searched this far around its predicted box [m].
constexpr float kSearchMargin = 0.5f;
/// Share of an object's samples that match the track it belongs to.
constexpr float kMinMemberShare = 0.6f;
/// Below this speed key frames near in time saw the object at its place [m/s].
constexpr float kSlow = 2;
/// Slower objects stand; they may stay hidden for long [m/s].
constexpr float kStanding = 0.5f;
/// An object that is less far from where it was stands at the same place [m].
constexpr float kSamePlace = 0.5f;
/// No road user speeds up, brakes or bends its path harder [m/s^2].
constexpr float kMaxAcceleration = 8;
/// Objects this wide are no persons [m].
constexpr float kMinRigidWidth = 1.4f;
/// No vehicle is wider [m]: 2.55 by law, its mirrors, and noise.
constexpr float kMaxVehicleWidth = 3.2f;

}  // namespace docdepth
