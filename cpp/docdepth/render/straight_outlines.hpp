// Outlines between the returns of neighbouring rings.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"

namespace docdepth {

/// Straighten the left and right outlines of things.
///
/// In each ring a thing ends somewhere between its last return and the next ray, so an outline that
/// is straight comes out jagged. Where an outline goes on up and down over two rings, with the
/// nearer surface on the same side, a pixel within half the distance between returns of it shows
/// the surface, nearer or farther, that most pixels above and below it show. Thin things, twigs and
/// corners stay. Upper outlines run along rings and have no such jags.
/// @param spacing        mean distance between returns [pixel]
/// @param depth          row after row [m]; NaN for none
/// @param shown_objects  number of the object that each pixel shows; may be empty
void straighten_outlines(const Camera& camera, float spacing, std::vector<float>& depth,
                         std::vector<std::uint16_t>& shown_objects, int threads);

}  // namespace docdepth
