#include "docdepth/voting/range_image.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "docdepth/geometry/simd.hpp"
#include "docdepth/voting/padded_range_image.hpp"

namespace docdepth {
namespace {

/// Tolerances from here on are refused [m].
constexpr float kMaxTolerance = 1e6f;
constexpr std::uint32_t kNoReturn = 0xffffffff;

/// The power of two from which on no two floats differ by exactly `value`, since their spacing does
/// not divide it.
float tie_free_range(float value) {
  int exponent;
  const auto mantissa = static_cast<unsigned>(std::ldexp(std::frexp(value, &exponent), 24));
  const int lowest_bit = exponent - 24 + __builtin_ctz(mantissa);
  return std::ldexp(1.0f, std::min(lowest_bit + 24, 127));
}

// The ranges at which the vote of a window changes are kept as cells, the upper bits of floats from
// 1 m on. A range in another cell is certainly nearer or farther.
constexpr int kSpans = 4;
constexpr int kCellBits = 10;  // lower bits of a float that a cell drops
constexpr std::int32_t kFirstCell = 0x3f800000 >> kCellBits;  // holds all nearer ranges
constexpr std::int32_t kLastCell = 0xffff;  // holds all farther ranges: from 256 m on

DOCDEPTH_KERNEL std::int32_t cell_of(float range) {
  const std::int32_t cell = (std::bit_cast<std::int32_t>(range) >> kCellBits) - kFirstCell;
  return std::min(std::max(cell, 0), kLastCell);
}

DOCDEPTH_KERNEL Ints cells_of(const Floats& ranges) {
  const Ints cells = (reinterpret_cast<Ints>(ranges) >> kCellBits) - kFirstCell;
  const Ints above = cells > 0 ? cells : Ints{};
  return above < kLastCell ? above : kLastCell + Ints{};
}

/// Finds the spans of pixels that are not ground.
///
/// The loop of Algorithm 1 ends at the first return that the point is not in front of, which is
/// nearer than all returns before it. So only such descending returns matter. Points within the
/// tolerance of one, or between two that are near each other, are static: a span. The nearest spans
/// are kept. If there are more, the farthest kept one is reversed: it is undecided for all ranges
/// behind it.
struct FindSpans {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* corner, std::size_t stride,
                                  int window, float tolerance, float tie_free,
                                  std::uint32_t* spans) {
    for (std::size_t i = 0; i < count; i += kLanes) {
      const Floats nothing = kEmpty + Floats{};
      Floats top[kSpans], bottom[kSpans];
      for (int k = 0; k < kSpans; ++k) top[k] = bottom[k] = nothing;
      Floats& nearest = bottom[0];
      Ints found{};
      for (int row = 0; row < window; ++row) {
        for (int column = 0; column < window; ++column) {
          const Floats next = load(corner + i + row * stride + column);
          // At a tie the loop ends without a vote, so a return with possible ties starts a new
          // span.
          const Ints apart = (nearest - next > 1.999f * tolerance) | (next < tie_free + tolerance);
          const Ints begins = (next < nearest) & apart;
          for (int k = kSpans - 1; k > 0; --k) {
            top[k] = begins ? top[k - 1] : top[k];
            bottom[k] = begins ? bottom[k - 1] : bottom[k];
          }
          top[0] = begins ? next : top[0];
          nearest = next < nearest ? next : nearest;
          found -= begins;
        }
      }
      // Differences of ranges this small are rounded.
      const Ints rounded = nearest < 3.0f * tolerance;
      for (int k = 0; k < kSpans; ++k) {
        const Ints far = cells_of(top[k] + tolerance), near = cells_of(bottom[k] - tolerance);
        const Ints reversed = k + 1 == kSpans ? found > kSpans : Ints{};
        const Ints known = reversed ? near << 16 | kLastCell : far << 16 | near;
        const Ints span = (found == 0) | rounded ? rounded & kLastCell : known;
        for (int lane = 0; lane < kLanes; ++lane)
          spans[(i + lane) * kSpans + k] = static_cast<std::uint32_t>(span[lane]);
      }
    }
  }
};

/// Algorithm 1 for all points except those in the end cells of a span or in a reversed span; these
/// stay open (negative).
struct DecideVotes {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* range,
                                  const std::uint32_t* __restrict spans,
                                  std::uint16_t* __restrict statics,
                                  std::uint16_t* __restrict dynamics,
                                  std::int32_t* __restrict open) {
    for (std::size_t i = 0; i < count; ++i) {
      const std::int32_t cell = cell_of(range[i]);
      // Signs of integers, since compilers do not vectorise booleans.
      std::int32_t inside = 0, before = -1, unsure = 0;
      for (int k = 0; k < kSpans; ++k) {
        const std::uint32_t span = spans[k * QueryPoints::kMax + i];
        const std::int32_t to_far = cell - static_cast<std::int32_t>(span >> 16);
        const std::int32_t to_near = cell - static_cast<std::int32_t>(span & 0xffff);
        inside |= to_far & ~to_near;
        before &= to_near;
        unsure |= (to_near & ~to_far) | ~((to_far | -to_far) & (to_near | -to_near));
      }
      const std::int32_t decided = ~unsure >> 31;
      statics[i] += decided & (inside >> 31) & 1;
      dynamics[i] += decided & (before >> 31) & 1;
      open[i] = unsure;
    }
  }
};

}  // namespace

RangeImage::RangeImage(const Points& points, const bool* ground,
                       const RangeImageParameters& parameters)
    : padded_(parameters.resolution, parameters.window / 2), tolerance_(parameters.tolerance) {
  if (parameters.window < 1 || parameters.window % 2 == 0)
    throw std::invalid_argument("the window must be an odd number of pixels");
  if (!(tolerance_ > 0.0f && tolerance_ < kMaxTolerance))
    throw std::invalid_argument("the range tolerance must be positive");
  draw(points, ground);
  summarize_windows();
}

void RangeImage::draw(const Points& points, const bool* ground) {
  const Returns returns(points);
  const std::vector<std::int32_t> pixels = padded_.fit(returns);
  std::vector<std::uint32_t> nearest(padded_.size(), kNoReturn);
  range_ = padded_.nearest_ranges(returns, pixels, &nearest);
  range_.resize(padded_.size() + kLanes, kEmpty);  // read by vectors, never used
  ground_.assign(range_.size(), 0);
  for (std::size_t i = 0; i < nearest.size(); ++i)
    ground_[i] = nearest[i] != kNoReturn && ground[returns.number[nearest[i]]];
}

void RangeImage::summarize_windows() {
  const std::size_t stride = padded_.stride(), rim = padded_.half() * (stride + 1);
  const float* corner = padded_.corner(range_);
  const float tie_free = tie_free_range(tolerance_);
  spans_.resize(range_.size());
  dispatch<FindSpans>(padded_.size() - 2 * rim, corner + rim, stride, 2 * padded_.half() + 1,
                      tolerance_, tie_free, spans_[rim].data());
  // At a ground pixel the loop runs over the whole window, and one return behind the point makes it
  // dynamic: the farthest one decides.
  std::vector<float> seen(range_);
  for (float& range : seen) range = range == kEmpty ? 0.0f : range;
  const std::vector<float> farthest = padded_.window_maximum(seen);
  for (std::size_t i = 0; i < padded_.size(); ++i)
    if (ground_[i]) spans_[i].fill(static_cast<std::uint32_t>(cell_of(farthest[i])) * 0x10001);
}

void RangeImage::find(const QueryPoints& points, std::int32_t* pixels) const {
  padded_.find(points, pixels);
  for (std::size_t i = 0; i < points.size; ++i) __builtin_prefetch(&spans_[pixels[i]]);
}

void RangeImage::vote(const QueryPoints& points, const std::int32_t* pixel, std::uint16_t* statics,
                      std::uint16_t* dynamics) const {
  static_assert(std::tuple_size<Spans>::value == kSpans);
  std::uint32_t spans[kSpans * QueryPoints::kMax];
  for (std::size_t i = 0; i < points.size; ++i)
    for (int k = 0; k < kSpans; ++k) spans[k * QueryPoints::kMax + i] = spans_[pixel[i]][k];
  std::int32_t open[QueryPoints::kMax];
  dispatch<DecideVotes>(points.size, points.range, spans, statics, dynamics, open);
  for_each_flagged(points.size, open, [&](std::size_t i) {
    const Vote vote = vote_at(points.range[i], pixel[i]);
    statics[i] += vote == Vote::kStatic;
    dynamics[i] += vote == Vote::kDynamic;
  });
}

/// Algorithm 1 as in the paper. The comparison rho < I - tau is rho - I < -tau here, so that both
/// tests round alike.
RangeImage::Vote RangeImage::vote_at(float range, std::size_t pixel) const {
  const bool centre_ground = ground_[pixel];
  const float tolerance = centre_ground ? 0.0f : tolerance_;
  Vote vote = Vote::kNone;
  const int half = padded_.half();
  for (int row = -half; row <= half; ++row) {
    const float* image = &range_[pixel + row * static_cast<std::ptrdiff_t>(padded_.stride())];
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
