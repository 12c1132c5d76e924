#include "docdepth/mesh/scan_rings.hpp"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <iterator>
#include <numeric>

namespace docdepth {
namespace {

using Numbers = std::vector<std::uint32_t>;

/// Fewer rings need no grid, and fewer returns to a ring show none.
constexpr std::size_t kFewestRings = 4, kFewestReturns = 100;
/// No LiDAR has more lasers.
constexpr std::size_t kMostRings = 1024;

/// A step along a ring [units]: at most ten degrees on or, from a near thing to a far one that the
/// vehicle saw from elsewhere, back; elevation changes by at most 0.3 degrees. So many of the steps
/// do.
constexpr std::int32_t kStep = kTurn / 36, kLevel = kTurn / 1200;
constexpr double kAlongRings = 0.8;
/// Rings begin within one of these sectors of azimuth.
constexpr std::int32_t kSectors = 64, kSector = kTurn / kSectors;

/// Between two rings elevations are at least so many times as rare as on them. So many of the
/// returns lie within a quarter of the way to the next ring.
constexpr std::uint32_t kRarer = 4;
constexpr double kOnRings = 0.8;
/// A ring begins with this share of the returns, and holds that of the next ring at its peak: less
/// is what echoes near the sensor leave between two rings.
constexpr double kFaintest = 0.001;
constexpr std::uint32_t kFainter = 4;
/// Elevations are counted over so many units on both sides.
constexpr std::int32_t kReach = 2;

/// Azimuth from one return to the next, by the shorter way.
std::int32_t turned(const Direction& from, const Direction& to) {
  static_assert(kTurn == 65536);
  return static_cast<std::int16_t>(to.azimuth - from.azimuth);
}

/// Ring of each of the numbers, if rows come ring by ring; else nothing.
Numbers rings_by_turns(const std::vector<Direction>& directions, const Numbers& numbers) {
  std::size_t level = 0, ups = 0, downs = 0, moves = 0;
  std::array<std::int32_t, kSectors> climbs = {};  // change of elevation in each sector
  for (std::size_t k = 1; k < numbers.size(); ++k) {
    const Direction &from = directions[numbers[k - 1]], &to = directions[numbers[k]];
    const std::int32_t step = turned(from, to), climb = to.elevation - from.elevation;
    if (step == 0 && climb == 0) continue;  // one return told twice shows no ring
    ++moves;
    level += std::abs(climb) <= kLevel;
    ups += step >= 0 && step <= kStep;
    downs += step <= 0 && step >= -kStep;
    climbs[(to.azimuth + kTurn / 2) / kSector] += climb;
  }
  const double steps = kAlongRings * static_cast<double>(moves);
  if (static_cast<double>(std::min(level, std::max(ups, downs))) < steps) return {};
  // All rings begin in one sector: there elevation changes from that of the first to the last.
  const auto most = std::max_element(climbs.begin(), climbs.end(),
                                     [](auto a, auto b) { return std::abs(a) < std::abs(b); });
  const auto seam = static_cast<std::int32_t>(most - climbs.begin()) * kSector + kSector / 2;
  const std::int32_t sign = ups > downs ? 1 : -1;
  std::int32_t way = sign * (directions[numbers[0]].azimuth + kTurn / 2 - seam);
  if (way < -kSector) way += kTurn;
  if (way >= kTurn - kSector) way -= kTurn;
  Numbers rings(numbers.size());
  std::uint32_t ring = 0;
  std::int32_t jump = -1;  // the largest change of elevation about the seam,
  std::size_t begin = 0;   // after which a ring begins
  for (std::size_t k = 1; k < numbers.size(); ++k) {
    const Direction &from = directions[numbers[k - 1]], &to = directions[numbers[k]];
    std::int32_t step = sign * turned(from, to);
    if (step < -kStep) step += kTurn;  // the next ring of a field of view of less than a turn
    way += step;
    rings[k] = ring;
    if (way < kTurn - kSector) continue;
    if (std::abs(to.elevation - from.elevation) > jump) {
      jump = std::abs(to.elevation - from.elevation);
      begin = k;
    }
    if (way < kTurn + kSector) continue;
    ++ring;
    std::fill(rings.begin() + begin, rings.begin() + k + 1, ring);
    way -= kTurn;
    jump = -1;
  }
  return rings;
}

/// Returns by elevation.
class Elevations {
 public:
  Elevations(const std::vector<Direction>& directions, const Numbers& numbers) {
    const auto [low, high] =
        std::minmax_element(numbers.begin(), numbers.end(), [&](std::uint32_t a, std::uint32_t b) {
          return directions[a].elevation < directions[b].elevation;
        });
    low_ = directions[*low].elevation;
    size_ = directions[*high].elevation - low_ + 1;
    below_.assign(static_cast<std::size_t>(size_) + 1, 0);
    for (const auto n : numbers) ++below_[place(directions[n]) + 1];
    std::partial_sum(below_.begin(), below_.end(), below_.begin());
  }

  std::int32_t size() const { return size_; }
  std::int32_t place(const Direction& direction) const { return direction.elevation - low_; }
  std::uint32_t around(std::int32_t y, std::int32_t reach) const {
    return below_[std::min(y + reach + 1, size_)] - below_[std::max(y - reach, 0)];
  }

 private:
  std::int32_t low_, size_;
  Numbers below_;  // returns below each elevation
};

struct Peak {
  std::int32_t border, at;  ///< the valley below it; the elevation of most returns
  std::uint32_t height;
};

/// The elevations of rings: peaks with valleys between them.
std::vector<Peak> find_peaks(const Elevations& elevations, std::uint32_t faintest) {
  std::vector<Peak> peaks;
  bool on_ring = false;
  std::uint32_t least = 0;                  // in the valley
  std::int32_t valley = 0, valley_end = 0;  // where it is deepest
  for (std::int32_t y = 0; y < elevations.size(); ++y) {
    const std::uint32_t some = elevations.around(y, kReach);
    if (!on_ring && some >= std::max({kRarer * least, faintest, 1u})) {
      on_ring = true;
      peaks.push_back({(valley + valley_end) / 2, y, 0});
    }
    if (on_ring && some > peaks.back().height) {
      peaks.back().height = some;
      peaks.back().at = y;
    }
    if (on_ring && kRarer * some <= peaks.back().height) {
      on_ring = false;
      least = some;
      valley = y;
    }
    if (!on_ring && some <= least) {
      if (some < least) valley = y;
      valley_end = y;
      least = some;
    }
  }
  std::vector<Peak> rings;
  for (std::size_t k = 0; k < peaks.size(); ++k) {
    const std::uint32_t before = k > 0 ? peaks[k - 1].height : 0;
    const std::uint32_t after = k + 1 < peaks.size() ? peaks[k + 1].height : 0;
    if (kFainter * peaks[k].height >= std::max(before, after)) rings.push_back(peaks[k]);
  }
  return rings;
}

/// Ring of each of the numbers, if their elevations lie at a few values; else nothing.
Numbers rings_by_elevation(const std::vector<Direction>& directions, const Numbers& numbers) {
  const Elevations elevations(directions, numbers);
  const auto all = static_cast<double>(numbers.size());
  const auto peaks = find_peaks(elevations, static_cast<std::uint32_t>(kFaintest * all));
  Numbers ring_at(elevations.size(), 0);
  std::uint32_t near = 0;
  for (std::size_t r = 0; r < peaks.size(); ++r) {
    std::int32_t gap = elevations.size();
    if (r > 0) gap = std::min(gap, peaks[r].at - peaks[r - 1].at);
    if (r + 1 < peaks.size()) gap = std::min(gap, peaks[r + 1].at - peaks[r].at);
    near += elevations.around(peaks[r].at, gap / 4);
    if (r > 0)
      std::fill(ring_at.begin() + peaks[r].border, ring_at.end(), static_cast<std::uint32_t>(r));
  }
  if (near < kOnRings * all) return {};
  Numbers rings(numbers.size());
  for (std::size_t k = 0; k < rings.size(); ++k)
    rings[k] = ring_at[elevations.place(directions[numbers[k]])];
  return rings;
}

/// New places of items in stable order of their keys, which are below `keys`.
template <class Key>
Numbers sorted_by(const Numbers& items, std::size_t keys, const Key& key) {
  Numbers place(keys + 1, 0), sorted(items.size());
  for (const auto item : items) ++place[key(item) + 1];
  std::partial_sum(place.begin(), place.end(), place.begin());
  for (const auto item : items) sorted[place[key(item)]++] = item;
  return sorted;
}

/// Append a ring by azimuth. It is in order but for its beginning, its direction and few returns.
void append_ring(const std::vector<Direction>& directions, const std::uint32_t* first,
                 const std::uint32_t* end, Numbers& returns) {
  const auto begin = static_cast<std::ptrdiff_t>(returns.size());
  const std::size_t count = end - first;
  if (count > 1 && turned(directions[first[0]], directions[first[count / 4]]) < 0)
    returns.insert(returns.end(), std::reverse_iterator(end), std::reverse_iterator(first));
  else
    returns.insert(returns.end(), first, end);
  const auto left_of = [&](std::uint32_t a, std::uint32_t b) {
    return directions[a].azimuth < directions[b].azimuth;
  };
  const auto ring = returns.begin() + begin;
  const auto seam = std::adjacent_find(ring, returns.end(), [&](std::uint32_t a, std::uint32_t b) {
    return directions[b].azimuth < directions[a].azimuth - kTurn / 2;
  });
  if (seam != returns.end()) std::rotate(ring, seam + 1, returns.end());
  if (!std::is_sorted(ring, returns.end(), left_of)) std::stable_sort(ring, returns.end(), left_of);
}

}  // namespace

ScanRings find_rings(const std::vector<Direction>& directions, const Numbers& numbers) {
  if (numbers.size() < kFewestRings * kFewestReturns) return {};
  const auto count_of = [](const Numbers& rings) {
    return rings.empty() ? 0 : *std::max_element(rings.begin(), rings.end()) + std::size_t{1};
  };
  const auto are_rings = [&](const Numbers& rings) {
    const std::size_t count = count_of(rings);
    return count >= kFewestRings && count <= kMostRings && count * kFewestReturns <= numbers.size();
  };
  Numbers rings = rings_by_turns(directions, numbers);
  if (!are_rings(rings)) rings = rings_by_elevation(directions, numbers);
  if (!are_rings(rings)) return {};
  // From the lowest to the highest.
  const std::size_t count = count_of(rings);
  std::vector<std::int64_t> elevation(count, 0), size(count, 0);
  for (std::size_t k = 0; k < rings.size(); ++k) {
    elevation[rings[k]] += directions[numbers[k]].elevation;
    ++size[rings[k]];
  }
  Numbers order, rank(count, 0);
  for (std::uint32_t r = 0; r < count; ++r)
    if (size[r] > 0) order.push_back(r);
  std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    return elevation[a] * size[b] < elevation[b] * size[a];
  });
  for (std::uint32_t k = 0; k < order.size(); ++k) rank[order[k]] = k;
  ScanRings found;
  found.begin.assign(1, 0);
  for (const auto r : order)
    found.begin.push_back(found.begin.back() + static_cast<std::uint32_t>(size[r]));
  if (std::is_sorted(rings.begin(), rings.end())) {
    found.returns.reserve(numbers.size());
    std::vector<std::size_t> first(count + 1, 0);
    for (std::size_t r = 0; r < count; ++r) first[r + 1] = first[r] + size[r];
    for (const auto r : order)
      append_ring(directions, &numbers[0] + first[r], &numbers[0] + first[r + 1], found.returns);
    return found;
  }

  Numbers items(numbers.size());
  std::iota(items.begin(), items.end(), 0);
  items = sorted_by(items, kTurn, [&](std::uint32_t k) {
    return static_cast<std::size_t>(directions[numbers[k]].azimuth + kTurn / 2);
  });
  found.returns = sorted_by(items, order.size(), [&](std::uint32_t k) { return rank[rings[k]]; });
  for (auto& item : found.returns) item = numbers[item];
  return found;
}

}  // namespace docdepth
