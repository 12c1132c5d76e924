// What the window around each pixel holds.
#pragma once

#include <cstddef>
#include <vector>

namespace docdepth {

/// An image whose rows follow each other, `stride` values each; windows reach `half` pixels to
/// either side. The pixels nearer than that to the first and the last row become 0; the columns
/// nearer than that to either end of a row mean nothing.
std::vector<float> window_minimum(const std::vector<float>& image, std::size_t stride, int half);
std::vector<float> window_maximum(const std::vector<float>& image, std::size_t stride, int half);
/// The first finite value, row by row; infinite where there is none.
std::vector<float> window_first(const std::vector<float>& image, std::size_t stride, int half);

}  // namespace docdepth
