// What a moving object hides beyond the edge of the sensor's field of view.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/triangles.hpp"

namespace docdepth {

/// Empty the static world where an object that the field of view cuts may hide it.
///
/// A truck beside us reaches above the highest beam. Sweeps taken before it came saw the street
/// there, but the truck hides it. From the cut the object is continued as far as its kind may
/// reach, and no static depth behind that remains. Every sweep that saw the object tells where it
/// was looked at. What is not followed may be several objects and is not continued.
/// @param owners  number of the dynamic object that each pixel shows, from 1 on; 0 for none; may be
///   empty if the scene has none
/// @param depth   [m], NaN for none
void empty_beyond_view(const Camera& camera, const MeshScene& scene,
                       const std::vector<std::uint16_t>& owners, std::vector<float>& depth);

}  // namespace docdepth
