// The static world behind the boxes of objects that move.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/triangles.hpp"

namespace docdepth {

/// Empty the static world behind a box where the object may hide it from the camera.
///
/// What is drawn there comes from sweeps that were taken before the object came or after it left:
/// the street behind the upper half of a truck that reaches above the highest beam, the wall behind
/// a person beside the view of the sensor. It stays where rays around the shutter tell two things:
///
/// - The object is not on the way from the camera. At places along the way through its box, all of
///   the four nearest rays passed, or ended on what stands still. Each is cached about the place
///   where that part of the box was when the ray was fired.
/// - The world is there. At least kMinEnded of the four nearest rays ended on what is drawn.
///
/// The second is not enough: the camera stands beside the sensor, and the object moves between the
/// ray and the image.
/// @param shown_objects  number of the dynamic object that each pixel shows, from 1 on; 0 for none;
/// may be
///   empty if the scene has none
/// @param depth   of the image [m]; NaN for none
void mask_unobserved_background(const Camera& camera, const MeshScene& scene,
                                const std::vector<std::uint16_t>& shown_objects,
                                std::vector<float>& depth, int threads);

}  // namespace docdepth
