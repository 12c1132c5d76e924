// What the window around each pixel holds.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace docdepth {

/// An image whose rows follow each other, `stride` values each; windows reach `half` pixels to
/// either side. The pixels nearer than that to the first and the last row become 0; the columns
/// nearer than that to either end of a row mean nothing.
std::vector<float> window_minimum(const std::vector<float>& image, std::size_t stride, int half);
std::vector<float> window_maximum(const std::vector<float>& image, std::size_t stride, int half);

/// Have the memory fetch the windows of those points, before the first one is looked at.
inline void fetch_windows(const float* corner, std::size_t stride, int window,
                          const std::int32_t* points, std::size_t count,
                          const std::int32_t* pixel) {
  for (std::size_t k = 0; k < count; ++k)
    for (int row = 0; row < window; ++row)
      __builtin_prefetch(corner + pixel[points[k]] + row * stride);
}

}  // namespace docdepth
