// Constants that the images of voting share.
#pragma once

#include <cstddef>
#include <limits>

namespace docdepth {

/// Pixel size of the images [rad]: 0.2 degrees, d_theta = d_phi of the paper.
constexpr double kImageResolution = 0.2 * 3.14159265358979323846 / 180.0;
/// Edge of the window around a pixel [pixel]: w of the paper (IV-D).
constexpr int kWindow = 5;
/// Range tolerance of a return [m]: tau of the paper (IV-D).
constexpr float kRangeTolerance = 0.2f;
/// Range of a pixel without a return.
constexpr float kEmpty = std::numeric_limits<float>::infinity();

}  // namespace docdepth
