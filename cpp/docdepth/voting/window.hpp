// Minimum and maximum in the window around each pixel.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace docdepth {

/// Windows reach `half` pixels to either side. Pixels nearer than that to the first and the last
/// row become 0; columns nearer than that to the ends of a row are not valid.
/// @param stride  values in a row
std::vector<float> window_minimum(const std::vector<float>& image, std::size_t stride, int half);
std::vector<float> window_maximum(const std::vector<float>& image, std::size_t stride, int half);

/// Prefetch the windows of these points.
inline void fetch_windows(const float* corner, std::size_t stride, int window,
                          const std::int32_t* points, std::size_t count,
                          const std::int32_t* pixel) {
  for (std::size_t k = 0; k < count; ++k)
    for (int row = 0; row < window; ++row)
      __builtin_prefetch(corner + pixel[points[k]] + row * stride);
}

}  // namespace docdepth
