#include "docdepth/voting/window.hpp"

#include <algorithm>

#include "docdepth/geometry/simd.hpp"

namespace docdepth {
namespace {

struct Smaller {
  DOCDEPTH_KERNEL static float of(float a, float b) { return a < b ? a : b; }
};
struct Larger {
  DOCDEPTH_KERNEL static float of(float a, float b) { return a > b ? a : b; }
};

/// out[i] = extremum of in[i], in[i + step], ..., in[i + (window - 1) step].
template <class Extremum>
struct Slide {
  DOCDEPTH_KERNEL static void run(std::size_t count, std::size_t step, int window,
                                  const float* __restrict in, float* __restrict out) {
    constexpr std::size_t kTile = 1024;  // values of `out`, which stay in the first level cache
    for (std::size_t begin = 0; begin < count; begin += kTile) {
      const std::size_t end = std::min(count, begin + kTile);
      for (std::size_t i = begin; i < end; ++i) out[i] = in[i];
      for (int k = 1; k < window; ++k) {
        const float* shifted = in + k * step;
        for (std::size_t i = begin; i < end; ++i) out[i] = Extremum::of(out[i], shifted[i]);
      }
    }
  }
};

/// A square window is separable: along the rows first, then along the columns.
template <class Extremum>
std::vector<float> slide(const std::vector<float>& image, std::size_t stride, int half) {
  const std::size_t rim = half * stride;
  std::vector<float> along(image.size()), result(image.size());
  dispatch<Slide<Extremum>>(image.size() - 2 * half, std::size_t{1}, 2 * half + 1, image.data(),
                            along.data() + half);
  dispatch<Slide<Extremum>>(image.size() - 2 * rim, stride, 2 * half + 1, along.data(),
                            result.data() + rim);
  return result;
}

}  // namespace

std::vector<float> window_minimum(const std::vector<float>& image, std::size_t stride, int half) {
  return slide<Smaller>(image, stride, half);
}

std::vector<float> window_maximum(const std::vector<float>& image, std::size_t stride, int half) {
  return slide<Larger>(image, stride, half);
}

}  // namespace docdepth
