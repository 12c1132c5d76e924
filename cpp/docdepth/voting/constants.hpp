// Constants of voting. What a caller may vary is in RangeImageParameters and MeshImageParameters;
// bit layouts stand with the code that reads them.
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
/// Larger ranges are no measurements [m]. Points without a direction are moved there; it is far
/// from overflow.
constexpr float kUnmeasured = 1e18f;
/// Tolerances from here on are refused [m].
constexpr float kMaxTolerance = 1e6f;
/// A plane nearer to the sensor has no usable normal form [m].
constexpr double kMinPlaneDistance = 0.01;
/// Points of a block. Its columns stay in the second level cache while all key frames vote, and it
/// reads much of each image before it goes to the next one.
constexpr std::size_t kVoteBlock = 8192;

}  // namespace docdepth
