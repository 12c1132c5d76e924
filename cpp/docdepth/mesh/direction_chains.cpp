#include "docdepth/mesh/direction_chains.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>

#include "docdepth/mesh/scan_rings.hpp"

namespace docdepth {
namespace {

/// Returns this near to the seam behind the sensor are repeated beyond the other end [units].
constexpr std::int32_t kSeamOverlap = kTurn / 24;
/// Guard vertices stand this far out [units], one degree beyond the repeated returns.
constexpr std::int32_t kGuardAzimuth = kTurn / 2 + kSeamOverlap + kTurn / 360;
/// Where there are no rings, strips of returns are this many times as high as evenly spread returns
/// would be apart.
constexpr double kStripHeight = 2.0;

bool same(const Vertex& a, const Vertex& b) {
  return a.x == b.x && a.y == b.y;
}

/// Stable counting sort by keys below `keys`.
/// @return first vertex of each key, and the end
template <class Key>
std::vector<std::uint32_t> counting_sort(std::vector<Vertex>& vertices, std::size_t keys,
                                         const Key& key) {
  std::vector<std::uint32_t> begin(keys + 1, 0);
  for (const Vertex& v : vertices) ++begin[key(v) + 1];
  for (std::size_t k = 0; k < keys; ++k) begin[k + 1] += begin[k];
  auto position = begin;
  std::vector<Vertex> sorted(vertices.size());
  for (const Vertex& v : vertices) sorted[position[key(v)]++] = v;
  vertices.swap(sorted);
  return begin;
}

/// Cut elevations into strips of about `height`, at elevations with few returns. A cut through a
/// ring leaves a row of slivers between its halves, which takes up to ten times the flips (measured
/// with sixteen rings).
///
/// @param below  number of returns below each elevation, and of all
std::vector<std::int32_t> strips_of(const std::vector<std::uint32_t>& below, std::int32_t height) {
  const auto count = static_cast<std::int32_t>(below.size()) - 1, reach = height / 4;
  const auto around = [&](std::int32_t y) {
    return below[std::min(y + reach, count)] - below[std::max(y - reach, 0)];
  };
  std::vector<std::int32_t> borders = {0};
  while (borders.back() < count) {
    const std::int32_t aim = borders.back() + height, last = std::min(aim + height / 2, count);
    std::int32_t best = std::min(aim, count);
    for (std::int32_t y = aim - height / 2; y <= last; ++y) {
      const auto gain = std::int64_t{around(best)} - around(y);
      if (gain > 0 || (gain == 0 && std::abs(y - aim) < std::abs(best - aim))) best = y;
    }
    borders.push_back(best);
  }
  return borders;
}

class ChainMaker {
 public:
  ChainMaker(const std::vector<Direction>& directions, const std::vector<std::uint32_t>& numbers);
  Chains take() { return std::move(chains_); }

 private:
  void add_strips();
  void add_rings(const ScanRings& rings);
  void add_guard_row(std::int32_t y);
  void add_guard(std::int32_t x, std::int32_t y) { chains_.vertices.push_back({x, y, guard_++}); }
  void begin_chain() {
    chains_.begin.push_back(static_cast<std::uint32_t>(chains_.vertices.size()));
  }

  const std::vector<Direction>& directions_;
  const std::vector<std::uint32_t>& numbers_;
  Chains chains_;
  std::uint32_t guard_;  // number of the next one
  std::int32_t low_ = kTurn, high_ = -kTurn, height_, guard_distance_;
  std::int32_t last_ = -kTurn;  // elevation of the guards of the last ring
};

ChainMaker::ChainMaker(const std::vector<Direction>& directions,
                       const std::vector<std::uint32_t>& numbers)
    : directions_(directions),
      numbers_(numbers),
      guard_(static_cast<std::uint32_t>(directions.size())) {
  std::int32_t left = kTurn, right = -kTurn;
  for (const auto n : numbers) {
    const auto [x, y] = directions[n];
    low_ = std::min(low_, y);
    high_ = std::max(high_, y);
    left = std::min(left, x);
    right = std::max(right, x);
  }
  const double area = (high_ - low_ + 1.0) * (right - left + 1.0);
  height_ = std::max<std::int32_t>(2, std::lround(kStripHeight * std::sqrt(area / numbers.size())));
  // Guards stand so far out that they only take slivers from the border.
  guard_distance_ = std::max(kTurn / 360, 2 * height_);
  chains_.vertices.reserve(numbers.size() + numbers.size() / 8);
  add_guard_row(low_ - guard_distance_);
  const ScanRings rings = find_rings(directions, numbers);
  if (rings.count() > 0)
    add_rings(rings);
  else
    add_strips();
  add_guard_row(std::max(high_, last_) + guard_distance_);
  begin_chain();
}

/// A chain of guards at elevation y.
void ChainMaker::add_guard_row(std::int32_t y) {
  begin_chain();
  for (std::int32_t x = -kGuardAzimuth; x < kGuardAzimuth; x += guard_distance_) add_guard(x, y);
  add_guard(kGuardAzimuth, y);
}

/// Flat strips, which cannot cross.
void ChainMaker::add_strips() {
  std::vector<Vertex> sorted;
  sorted.reserve(numbers_.size() + numbers_.size() / 8);
  for (const auto n : numbers_) {
    const auto [x, y] = directions_[n];
    sorted.push_back({x, y, n});
    if (x < -kTurn / 2 + kSeamOverlap) sorted.push_back({x + kTurn, y, n});
    if (x >= kTurn / 2 - kSeamOverlap) sorted.push_back({x - kTurn, y, n});
  }
  // By strip; within a strip by azimuth, then elevation, then row.
  const auto below =
      counting_sort(sorted, high_ - low_ + 1, [&](const Vertex& v) { return v.y - low_; });
  counting_sort(sorted, 2 * kGuardAzimuth, [](const Vertex& v) { return v.x + kGuardAzimuth; });
  const std::vector<std::int32_t> borders = strips_of(below, height_);
  const std::size_t strips = borders.size() - 1;
  std::vector<std::uint16_t> strip_of(high_ - low_ + 1);
  for (std::size_t s = 0; s < strips; ++s)
    std::fill(strip_of.begin() + borders[s], strip_of.begin() + borders[s + 1], s);
  const auto begin =
      counting_sort(sorted, strips, [&](const Vertex& v) { return strip_of[v.y - low_]; });
  for (std::size_t s = 0; s < strips; ++s) {
    if (begin[s] == begin[s + 1]) continue;
    const std::int32_t middle = low_ + (borders[s] + borders[s + 1] - 1) / 2;
    begin_chain();
    add_guard(-kGuardAzimuth, middle);
    std::unique_copy(sorted.begin() + begin[s], sorted.begin() + begin[s + 1],
                     std::back_inserter(chains_.vertices), same);
    add_guard(kGuardAzimuth, middle);
  }
}

/// A chain for each ring. Most returns are in order already: only those of equal azimuth are not.
void ChainMaker::add_rings(const ScanRings& rings) {
  last_ = low_ - guard_distance_;
  auto& vertices = chains_.vertices;
  for (std::size_t r = 0; r < rings.count(); ++r) {
    const std::uint32_t *first = &rings.returns[rings.begin[r]],
                        *end = &rings.returns[0] + rings.begin[r + 1];
    std::int64_t sum = 0;
    for (const auto* n = first; n != end; ++n) sum += directions_[*n].elevation;
    // Guards of chains are in order like the chains, and below the last.
    const auto mean = static_cast<std::int32_t>(sum / (end - first));
    last_ = std::max(last_ + 1, mean);
    begin_chain();
    add_guard(-kGuardAzimuth, last_);
    const auto add = [&](std::uint32_t n, std::int32_t shift) {
      const Vertex v = {directions_[n].azimuth + shift, directions_[n].elevation, n};
      std::size_t place = vertices.size();
      while (before(v, vertices[place - 1])) --place;  // the guard is before all of them
      if (same(v, vertices[place - 1])) {
        vertices[place - 1].number = std::min(vertices[place - 1].number, n);
        return;
      }
      vertices.insert(vertices.begin() + static_cast<std::ptrdiff_t>(place), v);
    };
    const auto* seam = end;
    while (seam != first && directions_[*(seam - 1)].azimuth >= kTurn / 2 - kSeamOverlap) --seam;
    for (const auto* n = seam; n != end; ++n) add(*n, -kTurn);
    for (const auto* n = first; n != end; ++n) add(*n, 0);
    for (const auto* n = first; n != end; ++n) {
      if (directions_[*n].azimuth >= -kTurn / 2 + kSeamOverlap) break;
      add(*n, kTurn);
    }
    add_guard(kGuardAzimuth, last_);
  }
}

}  // namespace

Chains make_chains(const std::vector<Direction>& directions,
                   const std::vector<std::uint32_t>& numbers) {
  return ChainMaker(directions, numbers).take();
}

}  // namespace docdepth
