#include "docdepth/dynamics/range_image.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "docdepth/dynamics/window.hpp"
#include "docdepth/geometry/dispatch.hpp"

namespace docdepth {
namespace {

constexpr float kEmpty = std::numeric_limits<float>::infinity();
constexpr std::size_t kStrip = 512;  // points whose scratch stays in the first level cache

/// The returns of a sweep and their pixels, a column each.
struct Returns {
  std::vector<float> x, y, z, range;
  std::vector<std::uint8_t> ground;
  std::vector<std::int32_t> row, column;

  Returns(const Points& points, const bool* flags) {
    const auto count = static_cast<std::size_t>(points.rows());
    for (auto* values : {&x, &y, &z, &range}) values->resize(count);
    ground.resize(count);
    std::size_t used = 0;
    for (std::size_t i = 0; i < count; ++i) {
      x[used] = points(i, 0);
      y[used] = points(i, 1);
      z[used] = points(i, 2);
      range[used] = range_of(x[used], y[used], z[used]);
      ground[used] = flags[i];
      used += range[used] > 0.0f && range[used] < kEmpty;
    }
    range.resize(used);
    row.resize(used);
    column.resize(used);
  }

  std::size_t size() const { return range.size(); }
};

/// Power of two from which on floats are too coarse for two of them to differ by exactly `value`:
/// their spacing does not divide it.
float tie_free_range(float value) {
  int exponent;
  const auto mantissa = static_cast<unsigned>(std::ldexp(std::frexp(value, &exponent), 24));
  const int lowest_bit = exponent - 24 + __builtin_ctz(mantissa);
  return std::ldexp(1.0f, std::min(lowest_bit + 24, 127));
}

/// What settles a vote, of the nearest and the farthest return of a window.
struct Summarize {
  DOCDEPTH_KERNEL static void run(std::size_t count, const std::uint8_t* ground,
                                  const float* farthest, float* __restrict nearest) {
    for (std::size_t i = 0; i < count; ++i) {
      const float settling = ground[i] ? -farthest[i] : nearest[i];
      nearest[i] = settling == kEmpty ? 0.0f : settling;
    }
  }
};

/// Votes that settling_ decides. Algorithm 1 ends at the first pixel of the window that is not
/// farther than the point by the tolerance or more. Around ground there is no end, and one farther
/// return makes the point dynamic. Else, when even the nearest return is farther by the tolerance,
/// all are: dynamic. When it is within the tolerance no pixel ends the loop without a vote: static.
/// Only when it is nearer than the point does the order of the pixels matter.
struct SettleVotes {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* range, const float* settling,
                                  float tolerance, float tie_free,
                                  std::uint16_t* __restrict statics,
                                  std::uint16_t* __restrict dynamics,
                                  std::uint8_t* __restrict open) {
    for (std::size_t i = 0; i < count; ++i) {
      const float seen = settling[i];
      const float difference = range[i] - seen;
      // Choices between numbers, since compilers do not vectorise those between truth values.
      const int near_tolerance = difference < tolerance ? (range[i] >= tie_free ? 1 : 0) : 0;
      const int around_ground = seen > 0.0f ? 0 : 1;
      const int is_dynamic =
          around_ground ? (range[i] < -seen ? 1 : 0) : (difference < -tolerance ? 1 : 0);
      const int is_static = difference > -tolerance ? (around_ground ? 0 : near_tolerance) : 0;
      dynamics[i] += is_dynamic;
      statics[i] += is_static;
      open[i] = around_ground ? 0 : 1 - is_dynamic - is_static;
    }
  }
};

struct FindPixels {
  DOCDEPTH_KERNEL static void run(std::size_t count, const std::int32_t* row,
                                  const std::int32_t* column, std::int32_t top, std::int32_t rows,
                                  std::int32_t stride, std::int32_t left,
                                  std::int32_t* __restrict pixel) {
    for (std::size_t i = 0; i < count; ++i) {
      const std::int32_t image_row = std::min(std::max(row[i] - top, 0), rows - 1);
      pixel[i] = image_row * stride + column[i] + left;
    }
  }
};

}  // namespace

RangeImage::RangeImage(const Points& points, const bool* ground,
                       const RangeImageParameters& parameters)
    : grid_(parameters.resolution),
      half_(parameters.window / 2),
      tolerance_(parameters.tolerance),
      plain_(parameters.plain),
      stride_(grid_.columns() + 2 * half_),
      tie_free_(0.0f) {
  if (parameters.window < 1 || parameters.window % 2 == 0)
    throw std::invalid_argument("the window must be an odd number of pixels");
  if (!(tolerance_ > 0.0f && tolerance_ < 1e6f))
    throw std::invalid_argument("the range tolerance must be above zero");
  draw(points, ground);
  if (!plain_) summarize_windows();
}

void RangeImage::draw(const Points& points, const bool* ground) {
  Returns returns(points, ground);
  grid_.pixels(returns.size(), returns.x.data(), returns.y.data(), returns.z.data(),
               returns.range.data(), returns.row.data(), returns.column.data());
  const auto [first, last] = std::minmax_element(returns.row.begin(), returns.row.end());
  // Windows reach half_ rows, and are asked for half_ rows beyond the occupied ones; what lies
  // farther up or down is taken to the first or the last row, where nothing is known.
  const int rim = 2 * half_ + 1;
  const int occupied = returns.size() ? *last - *first + 1 : 0;
  top_ = returns.size() ? *first - rim : 0;
  rows_ = occupied + 2 * rim;

  range_.assign(rows_ * stride_, kEmpty);
  ground_.assign(range_.size(), 0);
  for (std::size_t i = 0; i < returns.size(); ++i) {
    const std::size_t pixel = (returns.row[i] - top_) * stride_ + returns.column[i] + half_;
    if (returns.range[i] >= range_[pixel]) continue;
    range_[pixel] = returns.range[i];
    ground_[pixel] = returns.ground[i];
  }
  // Windows wrap around: repeat the columns of either end beyond the other one.
  for (std::size_t row = 0; row < range_.size(); row += stride_) {
    for (int k = 0; k < half_; ++k) {
      range_[row + k] = range_[row + k + grid_.columns()];
      range_[row + half_ + grid_.columns() + k] = range_[row + half_ + k];
    }
  }
}

void RangeImage::summarize_windows() {
  std::vector<float> seen(range_);
  for (float& range : seen) range = range == kEmpty ? 0.0f : range;
  farthest_ = window_maximum(seen, stride_, half_);
  settling_ = window_minimum(range_, stride_, half_);
  dispatch<Summarize>(settling_.size(), ground_.data(), farthest_.data(), settling_.data());
  tie_free_ = tie_free_range(tolerance_);
}

void RangeImage::vote(const QueryPoints& points, std::uint16_t* statics,
                      std::uint16_t* dynamics) const {
  for (std::size_t begin = 0; begin < points.size; begin += kStrip) {
    const QueryPoints strip{std::min(kStrip, points.size - begin), points.x + begin,
                            points.y + begin, points.z + begin, points.range + begin};
    if (plain_) {
      vote_plainly(strip, statics + begin, dynamics + begin);
    } else {
      vote_fast(strip, statics + begin, dynamics + begin);
    }
  }
}

void RangeImage::vote_fast(const QueryPoints& points, std::uint16_t* statics,
                           std::uint16_t* dynamics) const {
  std::int32_t row[kStrip], column[kStrip], pixel[kStrip], undecided[kStrip];
  float settling[kStrip];
  std::uint8_t open[kStrip];
  grid_.pixels(points.size, points.x, points.y, points.z, points.range, row, column);
  dispatch<FindPixels>(points.size, row, column, top_, rows_, static_cast<std::int32_t>(stride_),
                       half_, pixel);
  for (std::size_t i = 0; i < points.size; ++i) settling[i] = settling_[pixel[i]];
  dispatch<SettleVotes>(points.size, points.range, settling, tolerance_, tie_free_, statics,
                        dynamics, open);
  std::size_t left = 0;
  for (std::size_t i = 0; i < points.size; ++i) {
    undecided[left] = static_cast<std::int32_t>(i);
    left += open[i];
  }
  for (std::size_t k = 0; k < left; ++k) {
    const std::int32_t i = undecided[k];
    // Behind everything in the window: none.
    if (points.range[i] - farthest_[pixel[i]] >= tolerance_) continue;
    const Vote vote = ask(points.range[i], pixel[i]);
    statics[i] += vote == Vote::kStatic;
    dynamics[i] += vote == Vote::kDynamic;
  }
}

void RangeImage::vote_plainly(const QueryPoints& points, std::uint16_t* statics,
                              std::uint16_t* dynamics) const {
  for (std::size_t i = 0; i < points.size; ++i) {
    const int row = grid_.row(points.z[i], points.range[i]) - top_;
    if (row < half_ || row >= rows_ - half_) continue;
    const std::size_t pixel = row * stride_ + grid_.column(points.x[i], points.y[i]) + half_;
    const Vote vote = ask(points.range[i], pixel);
    statics[i] += vote == Vote::kStatic;
    dynamics[i] += vote == Vote::kDynamic;
  }
}

/// Algorithm 1 to the letter. The comparison rho < I - tau reads rho - I < -tau here, so that both
/// tests round alike.
RangeImage::Vote RangeImage::ask(float range, std::size_t pixel) const {
  const bool centre_ground = ground_[pixel];
  const float tolerance = centre_ground ? 0.0f : tolerance_;
  Vote vote = Vote::kNone;
  for (int row = -half_; row <= half_; ++row) {
    const float* image = &range_[pixel + row * static_cast<std::ptrdiff_t>(stride_)];
    for (int column = -half_; column <= half_; ++column) {
      if (image[column] == kEmpty) continue;
      const float difference = range - image[column];
      if (std::fabs(difference) < tolerance) return Vote::kStatic;
      if (difference < -tolerance) {
        vote = Vote::kDynamic;
      } else if (!centre_ground) {
        return Vote::kNone;
      }
    }
  }
  return vote;
}

}  // namespace docdepth
