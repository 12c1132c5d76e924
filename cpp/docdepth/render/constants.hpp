// Constants that several files of the renderer share.
#pragma once

#include <cstddef>
#include <cstdint>

namespace docdepth {

/// Points nearer to the image plane are not drawn [m].
constexpr float kNear = 0.1f;
/// Class of a pixel or vertex that is no return.
constexpr std::uint8_t kNoClass = 255;

/// Nearer to the sensor a splat has its largest size [m]: below sqrt(e) the logarithm of the
/// paper's formula is less than 1.
constexpr double kLargestSplatRange = 1.65;

/// Triangles are drawn this much larger, so that rounding leaves no cracks [pixel].
constexpr float kSlack = 0.01f;

/// A point within this distance of a ray's end is on the surface [m], and its growth with range
/// [m/m].
constexpr float kSurfaceMargin = 0.1f;
constexpr float kSurfaceMarginGrowth = 0.03f;
/// How exactly the position of a ray is known [m].
constexpr float kRayBlur = 0.02f;

/// Rays at most this long before or after the shutter look at what the image shows [s]: a sweep of
/// a common LiDAR. Past an object that stands or goes slowly they do for longer.
constexpr float kShutter = 0.1f;
/// Behind the box of an object a point was seen if so many of the nearest rays around it, one in
/// each quadrant of direction, ended there. Beside a straight edge of the object two do.
constexpr int kMinEnded = 2;
/// Rays around a point are near if they lie within so many mean distances between returns, to each
/// side and up and down: both of two rings ten times farther apart than their returns.
constexpr float kNearRays = 4;

/// A measurement agrees with the depth map if it differs by at most this share.
constexpr float kAgree = 0.02f;

}  // namespace docdepth
