#include "docdepth/voting/padded_range_image.hpp"

#include <algorithm>

#include "docdepth/geometry/simd.hpp"

namespace docdepth {
namespace {

struct FindPixels {
  DOCDEPTH_KERNEL static void run(std::size_t count, const std::int32_t* row,
                                  const std::int32_t* column, std::int32_t top, std::int32_t rows,
                                  std::int32_t stride, std::int32_t half,
                                  std::int32_t* __restrict pixel) {
    for (std::size_t i = 0; i < count; ++i) {
      const std::int32_t image_row = std::min(std::max(row[i] - top, half), rows - 1 - half);
      pixel[i] = image_row * stride + column[i] + half;
    }
  }
};

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

Returns::Returns(const Points& points) {
  const auto count = static_cast<std::size_t>(points.rows());
  for (auto* values : {&x, &y, &z, &range}) values->resize(count);
  number.resize(count);
  std::size_t used = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const float px = points(i, 0), py = points(i, 1), pz = points(i, 2);
    const float rho = range_of(px, py, pz);
    x[used] = px;
    y[used] = py;
    z[used] = pz;
    range[used] = rho;
    number[used] = static_cast<std::uint32_t>(i);
    used += (rho > 0.0f) & (rho < kEmpty);
  }
  for (auto* values : {&x, &y, &z, &range}) values->resize(used);
  number.resize(used);
}

PaddedRangeImage::PaddedRangeImage(double resolution, int half)
    : grid_(resolution), half_(half), stride_(grid_.columns() + 2 * half) {}

std::vector<std::int32_t> PaddedRangeImage::fit(const Returns& returns) {
  std::vector<std::int32_t> row(returns.size()), column(returns.size());
  grid_.pixels(returns.size(), returns.x.data(), returns.y.data(), returns.z.data(),
               returns.range.data(), row.data(), column.data());
  const auto [first, last] = std::minmax_element(row.begin(), row.end());
  // Windows reach half_ rows, and are needed up to half_ rows beyond the occupied ones. Farther
  // rows are clamped to the first or last one, whose window is empty.
  const int rim = 2 * half_ + 1;
  const int occupied = returns.size() ? *last - *first + 1 : 0;
  top_ = returns.size() ? *first - rim : 0;
  rows_ = occupied + 2 * rim;
  for (std::size_t i = 0; i < returns.size(); ++i)
    row[i] = (row[i] - top_) * static_cast<std::int32_t>(stride_) + column[i] + half_;
  return row;
}

void PaddedRangeImage::find(const QueryPoints& points, std::int32_t* pixels) const {
  std::int32_t row[QueryPoints::kMax], column[QueryPoints::kMax];
  grid_.pixels(points.size, points.x, points.y, points.z, points.range, row, column);
  dispatch<FindPixels>(points.size, row, column, top_, rows_, static_cast<std::int32_t>(stride_),
                       half_, pixels);
}

std::vector<float> PaddedRangeImage::nearest_ranges(const Returns& returns,
                                                    const std::vector<std::int32_t>& pixels,
                                                    std::vector<std::uint32_t>* nearest) const {
  std::vector<float> image(size(), kEmpty);
  for (std::size_t i = 0; i < returns.size(); ++i) {
    if (returns.range[i] >= image[pixels[i]]) continue;
    image[pixels[i]] = returns.range[i];
    if (nearest) (*nearest)[pixels[i]] = static_cast<std::uint32_t>(i);
  }
  wrap(image);
  return image;
}

std::vector<float> PaddedRangeImage::window_minimum(const std::vector<float>& image) const {
  return slide<Smaller>(image, stride_, half_);
}

std::vector<float> PaddedRangeImage::window_maximum(const std::vector<float>& image) const {
  return slide<Larger>(image, stride_, half_);
}

}  // namespace docdepth
