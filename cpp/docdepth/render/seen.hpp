// Which pixels of a depth map the sensor looked at when the shutter fired.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/triangles.hpp"

namespace docdepth {

/// What rays around the shutter say of the depth of a pixel.
enum class Seen : std::uint8_t { kNotLookedAt = 0, kAgreed = 1, kContradicted = 2, kNoDepth = 255 };

/// State of each pixel, row after row.
///
/// The four nearest rays around the drawn point, one in each quadrant of direction, tell, of all
/// that were measured within kShutter and lie within kNearRays. All four ended on the surface
/// there: agreed. All passed through: contradicted. All ended before it, on something that hides it
/// from the camera, too: contradicted. Else, also if one is missing: not looked at.
///
/// @param objects  number of the dynamic object of each pixel, from 0 on; -1 for static ones
std::vector<Seen> seen_pixels(const Camera& camera, const MeshScene& scene, const float* depth,
                              const std::vector<std::int32_t>& objects, int threads);

}  // namespace docdepth
