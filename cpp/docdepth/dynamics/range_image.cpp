#include "docdepth/dynamics/range_image.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "docdepth/dynamics/window.hpp"
#include "docdepth/geometry/dispatch.hpp"
#include "docdepth/geometry/lanes.hpp"

namespace docdepth {
namespace {

constexpr float kEmpty = std::numeric_limits<float>::infinity();
constexpr std::uint32_t kNobody = 0xffffffff;

/// Power of two from which on floats are too coarse for two of them to differ by exactly `value`:
/// their spacing does not divide it.
float tie_free_range(float value) {
  int exponent;
  const auto mantissa = static_cast<unsigned>(std::ldexp(std::frexp(value, &exponent), 24));
  const int lowest_bit = exponent - 24 + __builtin_ctz(mantissa);
  return std::ldexp(1.0f, std::min(lowest_bit + 24, 127));
}

/// Algorithm 1 for as many points as two returns of their windows settle; the others stay open.
///
/// Around a ground pixel (nearest <= 0) the loop has no end but the window's, and one return behind
/// the point makes it dynamic: the farthest one tells. Elsewhere the loop ends at the first return
/// that is not behind the point by the tolerance, which is static within the tolerance. When the
/// window's first return is not that one, its nearest tells whether there is one at all, and that
/// it is static where not even the nearest is nearer than the point by the tolerance.
struct SettleVotes {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* range, const float* nearest,
                                  const float* first, float tolerance, float tie_free,
                                  std::uint16_t* __restrict statics,
                                  std::uint16_t* __restrict dynamics,
                                  std::uint8_t* __restrict open) {
    for (std::size_t i = 0; i < count; ++i) {
      const float to_first = range[i] - first[i], to_nearest = range[i] - nearest[i];
      // Choices between numbers, since compilers do not vectorise those between truth values.
      const int around_ground = nearest[i] > 0.0f ? 0 : 1;
      const int before_first = to_first < -tolerance ? 1 : 0;
      const int before_all = to_nearest < -tolerance ? 1 : 0;
      const int on_first = std::fabs(to_first) < tolerance ? 1 : 0;
      const int near = std::fabs(to_nearest) < tolerance ? 1 : 0;
      const int on_nearest = range[i] >= tie_free ? near : 0;
      const int before_farthest = range[i] < -nearest[i] ? 1 : 0;
      const int is_static = before_first ? on_nearest : on_first;
      const int is_dynamic = around_ground ? before_farthest : before_first & before_all;
      dynamics[i] += is_dynamic;
      statics[i] += around_ground ? 0 : is_static;
      open[i] = (1 - around_ground) & before_first & (1 - before_all) & (1 - on_nearest);
    }
  }
};

/// Algorithm 1 for points whose windows hold returns behind and before them but not around ground:
/// static or none, as the first return says that is not behind by the tolerance. A row of the
/// window at a time, each pixel in a lane of its own, keeping the first such pixel of each lane.
struct ScanWindows {
  DOCDEPTH_KERNEL static void run(std::size_t count, const std::int32_t* points, const float* range,
                                  const std::int32_t* pixel, const float* corner,
                                  std::size_t stride, int window, float tolerance,
                                  std::uint16_t* __restrict statics) {
    constexpr std::int32_t kNowhere = 1 << 20;
    Ints start;
    for (int lane = 0; lane < kLanes; ++lane) start[lane] = lane < window ? 2 * lane : kNowhere;
    for (std::size_t k = 0; k < count; ++k) {
      const std::int32_t i = points[k];
      const float* row = corner + pixel[i];
      Ints order = start, first = start + kNowhere;
      for (int r = 0; r < window; ++r, row += stride, order += 2 * kLanes) {
        Floats measured;
        std::memcpy(&measured, row, sizeof measured);
        const Floats difference = range[i] - measured;
        // Comparisons are -1 where they hold: an odd key is a static pixel.
        const Ints on = (difference > -tolerance) & (difference < tolerance);
        const Ints key = (difference < -tolerance) ? first : order - on;
        first = key < first ? key : first;
      }
      std::int32_t keys[kLanes];
      std::memcpy(keys, &first, sizeof keys);
      for (int half = kLanes / 2; half > 0; half /= 2)
        for (int lane = 0; lane < half; ++lane)
          keys[lane] = std::min(keys[lane], keys[lane + half]);
      statics[i] += keys[0] & 1;
    }
  }
};

}  // namespace

RangeImage::RangeImage(const Points& points, const bool* ground,
                       const RangeImageParameters& parameters)
    : canvas_(parameters.resolution, parameters.window / 2),
      tolerance_(parameters.tolerance),
      plain_(parameters.plain),
      tie_free_(0.0f) {
  if (parameters.window < 1 || parameters.window % 2 == 0)
    throw std::invalid_argument("the window must be an odd number of pixels");
  if (!(tolerance_ > 0.0f && tolerance_ < 1e6f))
    throw std::invalid_argument("the range tolerance must be above zero");
  draw(points, ground);
  if (!plain_) summarize_windows();
}

void RangeImage::draw(const Points& points, const bool* ground) {
  const Returns returns(points);
  const std::vector<std::int32_t> pixels = canvas_.fit(returns);
  std::vector<std::uint32_t> nearest(canvas_.size(), kNobody);
  range_ = canvas_.nearest_ranges(returns, pixels, &nearest);
  range_.resize(canvas_.size() + kLanes, kEmpty);  // may be read, never looked at
  ground_.assign(range_.size(), 0);
  for (std::size_t i = 0; i < nearest.size(); ++i)
    ground_[i] = nearest[i] != kNobody && ground[returns.number[nearest[i]]];
}

void RangeImage::summarize_windows() {
  std::vector<float> seen(range_);
  for (float& range : seen) range = range == kEmpty ? 0.0f : range;
  const std::vector<float> farthest = window_maximum(seen, canvas_.stride(), canvas_.half());
  const std::vector<float> nearest = window_minimum(range_, canvas_.stride(), canvas_.half());
  const std::vector<float> first = window_first(range_, canvas_.stride(), canvas_.half());
  windows_.resize(range_.size());
  for (std::size_t i = 0; i < windows_.size(); ++i) {
    const float known = nearest[i] == kEmpty ? 0.0f : nearest[i];
    windows_[i] = {ground_[i] ? -farthest[i] : known, first[i]};
  }
  tie_free_ = tie_free_range(tolerance_);
}

void RangeImage::find(const QueryPoints& points, std::int32_t* pixels) const {
  if (plain_) return;  // the plain loop finds them itself
  canvas_.find(points, pixels);
  for (std::size_t i = 0; i < points.size; ++i) __builtin_prefetch(&windows_[pixels[i]]);
}

void RangeImage::vote(const QueryPoints& points, const std::int32_t* pixel, std::uint16_t* statics,
                      std::uint16_t* dynamics) const {
  if (plain_) return vote_plainly(points, statics, dynamics);
  float nearest[QueryPoints::kMax], first[QueryPoints::kMax];
  for (std::size_t i = 0; i < points.size; ++i) {
    nearest[i] = windows_[pixel[i]].nearest;
    first[i] = windows_[pixel[i]].first;
  }
  std::uint8_t open[QueryPoints::kMax];
  dispatch<SettleVotes>(points.size, points.range, nearest, first, tolerance_, tie_free_, statics,
                        dynamics, open);
  std::int32_t left[QueryPoints::kMax + 1];
  std::size_t count = 0;
  for (std::size_t i = 0; i < points.size; ++i) {
    left[count] = static_cast<std::int32_t>(i);
    count += open[i];
  }
  const int window = 2 * canvas_.half() + 1;
  if (window <= kLanes) {
    const float* corner = canvas_.corner(range_);
    fetch_windows(corner, canvas_.stride(), window, left, count, pixel);
    dispatch<ScanWindows>(count, left, points.range, pixel, corner, canvas_.stride(), window,
                          tolerance_, statics);
    return;
  }
  for (std::size_t k = 0; k < count; ++k)
    statics[left[k]] += ask(points.range[left[k]], pixel[left[k]]) == Vote::kStatic;
}

void RangeImage::vote_plainly(const QueryPoints& points, std::uint16_t* statics,
                              std::uint16_t* dynamics) const {
  for (std::size_t i = 0; i < points.size; ++i) {
    const std::ptrdiff_t pixel =
        canvas_.pixel(points.x[i], points.y[i], points.z[i], points.range[i]);
    if (pixel < 0) continue;
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
  const int half = canvas_.half();
  for (int row = -half; row <= half; ++row) {
    const float* image = &range_[pixel + row * static_cast<std::ptrdiff_t>(canvas_.stride())];
    for (int column = -half; column <= half; ++column) {
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
