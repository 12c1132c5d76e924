// A row of a window at a time, each pixel in a lane of its own.
#pragma once

#include <cstddef>
#include <cstdint>

namespace docdepth {

constexpr int kLanes = 8;
using Floats = float __attribute__((vector_size(4 * kLanes)));
using Ints = std::int32_t __attribute__((vector_size(4 * kLanes)));

/// Have the memory fetch the windows of those points, before the first one is looked at.
inline void fetch_windows(const float* corner, std::size_t stride, int window,
                          const std::int32_t* points, std::size_t count,
                          const std::int32_t* pixel) {
  for (std::size_t k = 0; k < count; ++k)
    for (int row = 0; row < window; ++row)
      __builtin_prefetch(corner + pixel[points[k]] + row * stride);
}

}  // namespace docdepth
