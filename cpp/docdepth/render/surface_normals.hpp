// Normals of the surface that a depth map shows.
#pragma once

#include <vector>

#include "docdepth/render/camera.hpp"

namespace docdepth {

/// Replace normals by those of planes that are fitted to the depth map around each pixel.
///
/// The noise of single returns tilts a facet, but hardly a plane through the many facets around it.
/// The window around a pixel is the largest one that shows a plane within the noise of range, so it
/// ends at creases and jumps. A pixel near one of these takes a window beside it that still holds
/// it. Where no window is flat, as on leaves, the normal stays.
/// @param depth   [m], row after row; NaN or 0 where there is none
/// @param normal  x y z for each pixel, towards the camera
/// @return for each pixel how much its plane may lean [rad]: the deviation of the surface from it
///     over half the width of the window; infinite where no window is flat
std::vector<float> fit_normals(const Camera& camera, const float* depth, float* normal,
                               int threads);

}  // namespace docdepth
