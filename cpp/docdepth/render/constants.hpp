// Constants of the renderer. The sizes of memory layouts (tiles, strips, blocks, patches) stand in
// the classes that they lay out.
#pragma once

#include <cstddef>
#include <cstdint>

namespace docdepth {

// --- Camera ---

/// Points nearer to the image plane are not drawn [m].
constexpr float kNear = 0.1f;
/// Class of a pixel or vertex that is no return.
constexpr std::uint8_t kNoClass = 255;

// --- Splats ---

/// Nearer to the sensor a splat has its largest size [m]: below sqrt(e) the logarithm of the
/// paper's formula is less than 1.
constexpr double kLargestSplatRange = 1.65;

// --- Rasterising triangles ---

/// Triangles are drawn this much larger, so that rounding leaves no cracks [pixel].
constexpr float kSlack = 0.01f;

// --- Rays of a sweep, which tell free space from surfaces ---

/// A point within this distance of a ray's end is on the surface [m], and its growth with range
/// [m/m].
constexpr float kSurfaceMargin = 0.1f;
constexpr float kSurfaceMarginGrowth = 0.03f;
/// How exactly the position of a ray is known [m].
constexpr float kRayBlur = 0.02f;
/// The same for a dynamic object that was moved to the time of the image [m].
constexpr float kMovedRayBlur = 0.05f;
/// Edge of a cell of rays, in mean distances between returns. The search reads the nine cells
/// around a point, which then reach both of two rings ten times farther apart than their returns.
constexpr double kRayCellSize = 1.6;

// --- Field of view, and what the sensor did not look at ---

/// Rays at most this long before or after the shutter look at what the image shows [s]: a sweep of
/// a common LiDAR.
constexpr float kShutter = 0.1f;
/// An object may reach this far beyond the box of its track [m]: what was seen of it is not all.
constexpr float kBoxMargin = 0.05f;
/// Behind the box of an object a point was seen if so many of the nearest rays around it, one in
/// each quadrant of direction, ended there. Beside a straight edge of the object two do.
constexpr int kMinEnded = 2;
/// So many pixels to each side share one way through the box, and if they are at the same depth
/// what rays say of the place behind it: rays are farther apart than pixels.
constexpr int kWayCell = 2;
/// The way through the box is looked at in so many places at most.
constexpr int kMostPlaces = 8;
/// Rays around a point are near if they lie within so many mean distances between returns, to each
/// side and up and down: both of two rings ten times farther apart than their returns.
constexpr float kNearRays = 4;
/// A surface may hide what is drawn within so many mean distances between returns beside it, and at
/// most so many pixels.
constexpr float kFrontRays = 2;
constexpr int kMostFront = 32;

// --- Depth hypotheses ---

/// Depths that differ by a smaller share are one surface.
constexpr float kSameDepth = 0.04f;
/// An edge is a second difference of inverse depth (0 on every plane) above this share of it.
constexpr float kEdgeBend = 0.05f;

// A ray that passes at distance d scores 1 / (d + blur)^2 [1/m^2], positive where it ended on a
// surface and negative where it passed through.

/// One ray within a centimetre, or many farther off, prove free space.
constexpr float kSureScore = 1000.0f;
/// The same for a surface. It takes more, since a ray may end next to a gap.
constexpr float kSureSurfaceScore = 1350.0f;
/// One ray whose distance and blur add up to 10 cm, or many farther off. With a higher score a
/// surface is continued over an edge.
constexpr float kCloseScore = 100.0f;
/// Pixels at edges with a lower score are left empty: no ray within 25 cm, blur included.
constexpr float kMinEdgeScore = 15.0f;

// --- Partition of a mesh into static surface and objects ---

/// Over a discontinuity of its own an object goes on for this share of the way to the next return:
/// a little past the middle, so that no crack is left.
constexpr float kInnerShare = 0.6f;
/// The same beyond its last return, and for the nearer side of static surface. Rays tell where it
/// ends: almost at the next one if the rays of other sweeps that passed beside it passed there.
constexpr float kOuterShare = 0.98f;

// --- Rays around objects ---

/// Rays that pass this far behind a measured surface of an object contradict it [m]. Nearer, a ray
/// may have passed just above a roof that it saw at a grazing angle.
constexpr float kWithinObject = 0.15f;
/// They do with a score below this, without its sign: five rays within a few centimetres, or more
/// farther off. Then what is behind is seen.
constexpr float kContradictedScore = 2000.0f;
/// With a score below this, without its sign, nobody knows: two rays within 2 cm, or more farther
/// off. Glass returns some rays and lets others pass.
constexpr float kDoubtedScore = 400.0f;
/// Where an object is continued beyond its returns, pixels show it with a score above this: one ray
/// whose distance and blur add up to 14 cm, or more farther off.
constexpr float kContinuedScore = 50.0f;
/// They show what is behind only with a score below this, without its sign: a ray that passed
/// within 2 cm, its blur not included, or some farther off. Nearer to the object its outline may
/// lie beyond them.
constexpr float kUnsureScore = 200.0f;

/// Rays that pass within this distance of an object tell where it ends [m] ...
constexpr float kOutlineReach = 1.0f;
/// ... and within this angle [rad], 2.5 degrees: more than the rings of any LiDAR are apart.
constexpr float kOutlineAngle = 0.044f;

// --- Layers ---

/// A measurement agrees with the depth map if it differs by at most this share.
constexpr float kAgree = 0.02f;

}  // namespace docdepth
