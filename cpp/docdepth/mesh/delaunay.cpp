// The returns of a sweep lie in rings. So the directions are cut into flat strips, each strip is
// sorted by azimuth, neighbouring strips are triangulated in linear time, and edge flips (Lawson)
// finish the Delaunay triangulation. All predicates are exact in integers, so the flips always end.
//
// Why not a library: labels and depth have to be the same on every machine, and integers make the
// triangulation exact and unique. General libraries do not use that returns lie in rings: Qhull, by
// scipy, takes 1.2 s for the 130,000 returns of a sweep.
#include "docdepth/mesh/delaunay.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <memory>

namespace docdepth {
namespace {

/// The cylinder of directions is unrolled onto a plane. Returns this near to the seam behind the
/// sensor are repeated beyond the other end [units].
constexpr std::int32_t kSeamOverlap = kTurn / 24;
/// Guard vertices stand this far out [units], one degree beyond the repeated returns.
constexpr std::int32_t kGuardAzimuth = kTurn / 2 + kSeamOverlap + kTurn / 360;
/// Strips of returns are this many times as high as evenly spread returns would be apart: about a
/// ring or two. Measured on HDL-64: half of it makes six times the flips, twice of it half as many
/// more.
constexpr double kStripHeight = 2.0;
struct Vertex {
  std::int32_t x, y;
  std::uint32_t number;  // row of the return; guards continue the numbering
};

bool same(const Vertex& a, const Vertex& b) {
  return a.x == b.x && a.y == b.y;
}
bool before(const Vertex& a, const Vertex& b) {
  return a.x != b.x ? a.x < b.x : a.y < b.y;
}

/// Twice the signed area of a, b, c: positive if they turn counterclockwise.
std::int64_t orientation(const Vertex& a, const Vertex& b, const Vertex& c) {
  return std::int64_t{b.x - a.x} * (c.y - a.y) - std::int64_t{b.y - a.y} * (c.x - a.x);
}

__extension__ typedef __int128 Wide;

/// Whether d lies inside the circle through a, b, c (counterclockwise). The angles at c and d that
/// subtend a-b add up to more than half a turn inside and to less outside (Cline and Renka 1984).
/// Of four returns on one circle the edge must touch the one with the lowest row.
bool is_within(const Vertex& a, const Vertex& b, const Vertex& c, const Vertex& d) {
  const double cax = a.x - c.x, cay = a.y - c.y, cbx = b.x - c.x, cby = b.y - c.y;
  const double dax = a.x - d.x, day = a.y - d.y, dbx = b.x - d.x, dby = b.y - d.y;
  const double sine_c = cax * cby - cay * cbx, cosine_c = cax * cbx + cay * cby;
  const double sine_d = dbx * day - dby * dax, cosine_d = dax * dbx + day * dby;
  // Integers up to here. Only the products of two of them may be rounded.
  const double one = sine_c * cosine_d, two = cosine_c * sine_d, sum = one + two;
  if (std::fabs(sum) > (std::fabs(one) + std::fabs(two)) * 0x1p-51) return sum < 0;
  const auto whole = [](double v) { return static_cast<Wide>(static_cast<std::int64_t>(v)); };
  const Wide exact = whole(sine_c) * whole(cosine_d) + whole(cosine_c) * whole(sine_d);
  if (exact != 0) return exact < 0;
  return std::min(c.number, d.number) < std::min(a.number, b.number);
}

/// What lies beyond a half edge: its other half (below kOpenChain), or the edge of a chain after
/// vertex n - kOpenChain whose upper side is not triangulated yet, or nothing (kNone).
constexpr std::uint32_t kOpenChain = 0x80000000;

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

class Triangulator {
 public:
  Triangulator(const std::vector<Direction>& directions, const std::vector<std::uint32_t>& numbers);
  Triangulation triangulation(std::size_t returns) const;

 private:
  /// An edge from a corner to the next, counterclockwise. Triangle t has the edges 4 t, 4 t + 1 and
  /// 4 t + 2, which lie together in the cache; 4 t + 3 is not used.
  struct HalfEdge {
    std::uint32_t corner, across;
  };

  void lay_out(const std::vector<Direction>& directions, const std::vector<std::uint32_t>& numbers);
  void add_guard_row(std::int32_t y, std::int32_t distance, std::uint32_t& guard);
  void join(std::size_t lower, std::size_t upper);
  void legalize(std::uint32_t first);
  bool flip(std::uint32_t e);
  std::uint32_t add(std::uint32_t a, std::uint32_t b, std::uint32_t c);
  void link(std::uint32_t e, std::uint32_t beyond);

  static std::uint32_t next(std::uint32_t e) { return e % 4 == 2 ? e - 2 : e + 1; }
  static std::uint32_t previous(std::uint32_t e) { return e % 4 == 0 ? e + 2 : e - 1; }

  std::vector<Vertex> vertices_;
  std::vector<std::uint32_t> strip_begin_;  // of the non-empty strips, and the end
  // Plain memory: a vector would zero it first and check its capacity at every use.
  std::unique_ptr<HalfEdge[]> edges_;  // at most two triangles a vertex
  std::uint32_t edge_count_ = 0;
  std::vector<std::uint32_t> below_;  // half edge below vertex k and the next one of its strip

  struct Open {
    std::uint32_t vertex;
    std::uint32_t line;  // beyond the edge to the previous vertex on the stack
  };
  std::unique_ptr<Open[]> stack_;
  std::vector<std::uint32_t> doubtful_;  // half edges that may have to flip
};

Triangulator::Triangulator(const std::vector<Direction>& directions,
                           const std::vector<std::uint32_t>& numbers) {
  lay_out(directions, numbers);
  edges_.reset(new HalfEdge[8 * vertices_.size()]);
  below_.assign(vertices_.size(), kNone);
  stack_.reset(new Open[vertices_.size()]);
  // One strip after the other, while it is in the cache.
  for (std::size_t s = 0; s + 2 < strip_begin_.size(); ++s) {
    const std::uint32_t first = edge_count_;
    join(s, s + 1);
    legalize(first);
  }
}

/// A strip of guards at elevation y.
void Triangulator::add_guard_row(std::int32_t y, std::int32_t distance, std::uint32_t& guard) {
  strip_begin_.push_back(static_cast<std::uint32_t>(vertices_.size()));
  for (std::int32_t x = -kGuardAzimuth; x < kGuardAzimuth; x += distance)
    vertices_.push_back({x, y, guard++});
  vertices_.push_back({kGuardAzimuth, y, guard++});
}

/// Sort the returns into strips, with guards around them.
void Triangulator::lay_out(const std::vector<Direction>& directions,
                           const std::vector<std::uint32_t>& numbers) {
  std::vector<Vertex> sorted;
  sorted.reserve(numbers.size() + numbers.size() / 8);
  std::int32_t low = kTurn, high = -kTurn, left = kTurn, right = -kTurn;
  for (const auto n : numbers) {
    const auto [x, y] = directions[n];
    low = std::min(low, y);
    high = std::max(high, y);
    left = std::min(left, x);
    right = std::max(right, x);
    sorted.push_back({x, y, n});
    if (x < -kTurn / 2 + kSeamOverlap) sorted.push_back({x + kTurn, y, n});
    if (x >= kTurn / 2 - kSeamOverlap) sorted.push_back({x - kTurn, y, n});
  }
  const double area = (high - low + 1.0) * (right - left + 1.0);
  const auto height =
      std::max<std::int32_t>(2, std::lround(kStripHeight * std::sqrt(area / numbers.size())));
  // Guards stand so far out that they only take slivers from the border.
  const std::int32_t guard_distance = std::max(kTurn / 360, 2 * height);

  // By strip; within a strip by azimuth, then elevation, then row.
  const auto by_elevation = [&](const Vertex& v) { return v.y - low; };
  const auto below = counting_sort(sorted, high - low + 1, by_elevation);
  counting_sort(sorted, 2 * kGuardAzimuth, [](const Vertex& v) { return v.x + kGuardAzimuth; });
  const std::vector<std::int32_t> borders = strips_of(below, height);
  const std::size_t strips = borders.size() - 1;
  std::vector<std::uint16_t> strip_of(high - low + 1);
  for (std::size_t s = 0; s < strips; ++s)
    std::fill(strip_of.begin() + borders[s], strip_of.begin() + borders[s + 1], s);
  const auto begin =
      counting_sort(sorted, strips, [&](const Vertex& v) { return strip_of[v.y - low]; });

  auto guard = static_cast<std::uint32_t>(directions.size());
  vertices_.reserve(sorted.size() + 2 * strips + 4 * kGuardAzimuth / guard_distance + 4);
  add_guard_row(low - guard_distance, guard_distance, guard);
  for (std::size_t s = 0; s < strips; ++s) {
    if (begin[s] == begin[s + 1]) continue;
    const std::int32_t middle = low + (borders[s] + borders[s + 1] - 1) / 2;
    strip_begin_.push_back(static_cast<std::uint32_t>(vertices_.size()));
    vertices_.push_back({-kGuardAzimuth, middle, guard++});
    std::unique_copy(sorted.begin() + begin[s], sorted.begin() + begin[s + 1],
                     std::back_inserter(vertices_), same);
    vertices_.push_back({kGuardAzimuth, middle, guard++});
  }
  add_guard_row(high + guard_distance, guard_distance, guard);
  strip_begin_.push_back(static_cast<std::uint32_t>(vertices_.size()));
}

std::uint32_t Triangulator::add(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
  const std::uint32_t e = edge_count_;
  edges_[e] = {a, kNone}, edges_[e + 1] = {b, kNone}, edges_[e + 2] = {c, kNone};
  edges_[e + 3] = {kNone, kNone};
  edge_count_ += 4;
  return e;
}

/// Connect half edge e with what lies beyond it.
void Triangulator::link(std::uint32_t e, std::uint32_t beyond) {
  edges_[e].across = beyond;
  if (beyond < kOpenChain)
    edges_[beyond].across = e;
  else if (beyond != kNone)
    below_[beyond - kOpenChain] = e;
}

/// Triangulate between two neighbouring strips. Their chains bound a polygon that is monotone in
/// azimuth, so one pass with a stack suffices (Garey et al. 1978).
void Triangulator::join(std::size_t lower, std::size_t upper) {
  std::uint32_t i = strip_begin_[lower], j = strip_begin_[upper];
  const std::uint32_t i_end = strip_begin_[lower + 1], j_end = strip_begin_[upper + 1];
  std::size_t open = 0;
  stack_[open++] = {i++, kNone};
  stack_[open++] = {j++, kNone};
  bool top_on_upper = true;
  while (i < i_end || j < j_end) {
    const bool on_upper = i == i_end || (j < j_end && before(vertices_[j], vertices_[i]));
    const std::uint32_t v = on_upper ? j++ : i++;
    // The chain's edge that ends at v.
    std::uint32_t line = on_upper ? (kOpenChain | (v - 1)) : below_[v - 1];
    if (on_upper == top_on_upper) {
      // Cut off the corners of the chain that are visible from v.
      while (open >= 2) {
        const Open mid = stack_[open - 1], far = stack_[open - 2];
        const auto turn = orientation(vertices_[far.vertex], vertices_[mid.vertex], vertices_[v]);
        if (on_upper ? turn >= 0 : turn <= 0) break;
        const std::uint32_t e = on_upper ? add(v, mid.vertex, far.vertex)   // v-mid, mid-far, far-v
                                         : add(v, far.vertex, mid.vertex);  // v-far, far-mid, mid-v
        link(e + 1, mid.line);
        link(on_upper ? e : e + 2, line);
        line = on_upper ? e + 2 : e;
        --open;
      }
    } else {
      // All open vertices of the other chain are visible from v; `line` leads to the first.
      for (std::size_t k = 0; k + 1 < open; ++k) {
        const std::uint32_t far = stack_[k].vertex, mid = stack_[k + 1].vertex;
        const std::uint32_t e = on_upper ? add(v, far, mid)   // v-far, far-mid, mid-v
                                         : add(v, mid, far);  // v-mid, mid-far, far-v
        link(e + 1, stack_[k + 1].line);
        link(on_upper ? e : e + 2, line);
        line = on_upper ? e + 2 : e;
      }
      stack_[0] = {stack_[open - 1].vertex, kNone};
      open = 1;
    }
    stack_[open++] = {v, line};
    top_on_upper = on_upper;
  }
}

/// Flip edges (Lawson) until every edge from `first` on is Delaunay, and every other one again.
void Triangulator::legalize(std::uint32_t first) {
  for (std::uint32_t start = first; start < edge_count_; ++start) {
    if (edges_[start].across > start) continue;  // it is tested from the other side
    if (!flip(start)) continue;                  // most are Delaunay
    while (!doubtful_.empty()) {
      const std::uint32_t e = doubtful_.back();
      doubtful_.pop_back();
      flip(e);
    }
  }
}

/// Flip an edge if it is not Delaunay; the four edges around it become doubtful.
inline bool Triangulator::flip(std::uint32_t e) {
  const std::uint32_t f = edges_[e].across;
  if (f >= kOpenChain) return false;
  const std::uint32_t ep = previous(e), fp = previous(f);
  const std::uint32_t a = edges_[e].corner, b = edges_[f].corner;
  const std::uint32_t c = edges_[ep].corner, d = edges_[fp].corner;
  if (!is_within(vertices_[a], vertices_[b], vertices_[c], vertices_[d])) return false;
  // a b c and b a d become d b c and c a d.
  edges_[e].corner = d;
  edges_[f].corner = c;
  link(e, edges_[fp].across);
  link(f, edges_[ep].across);
  link(ep, fp);
  for (const auto outer : {e, next(e), f, next(f)}) doubtful_.push_back(outer);
  return true;
}

Triangulation Triangulator::triangulation(std::size_t returns) const {
  Triangulation result;
  std::vector<std::uint32_t> renamed(edge_count_ / 4, kNone);
  result.corners.reserve(renamed.size());
  for (std::uint32_t t = 0; t < renamed.size(); ++t) {
    const Vertex &a = vertices_[edges_[4 * t].corner], &b = vertices_[edges_[4 * t + 1].corner],
                 &c = vertices_[edges_[4 * t + 2].corner];
    // A triangle near the seam has copies. The one whose leftmost corner is no copy is kept.
    const std::int32_t left = std::min(a.x, std::min(b.x, c.x));
    const bool is_copy = left < -kTurn / 2 || left >= kTurn / 2;
    if (is_copy || std::max(a.number, std::max(b.number, c.number)) >= returns) continue;
    renamed[t] = static_cast<std::uint32_t>(result.corners.size());
    result.corners.push_back({a.number, b.number, c.number});
  }
  // At the seam the neighbour that is kept is another copy, found by the rows of the edge.
  std::vector<std::array<std::uint32_t, 4>> seam;  // rows of the edge, triangle, edge
  result.across.resize(result.corners.size());
  for (std::uint32_t t = 0; t < renamed.size(); ++t) {
    const std::uint32_t kept = renamed[t];
    if (kept == kNone) continue;
    for (std::uint32_t i = 0; i < 3; ++i) {
      const std::uint32_t f = edges_[4 * t + i].across;
      const std::uint32_t beyond = f < kOpenChain ? renamed[f / 4] : kNone;
      result.across[kept][i] = beyond;
      if (beyond != kNone) continue;
      const auto& corners = result.corners[kept];
      const auto [a, b] = std::minmax(corners[i], corners[(i + 1) % 3]);
      seam.push_back({a, b, kept, i});
    }
  }
  std::sort(seam.begin(), seam.end());
  for (std::size_t k = 0; k + 1 < seam.size(); ++k) {
    const auto &a = seam[k], &b = seam[k + 1];
    if (a[0] != b[0] || a[1] != b[1]) continue;
    result.across[a[2]][a[3]] = b[2];
    result.across[b[2]][b[3]] = a[2];
  }
  return result;
}

}  // namespace

Triangulation triangulate(const std::vector<Direction>& directions,
                          const std::vector<std::uint32_t>& numbers) {
  if (numbers.size() < 3) return {};
  return Triangulator(directions, numbers).triangulation(directions.size());
}

}  // namespace docdepth
