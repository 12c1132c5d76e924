// Sweeps are rows of returns, more or less: cut the directions into flat strips, order each strip
// by azimuth, triangulate between neighbouring strips in linear time, and let edge flips (Lawson)
// do the rest. All predicates are exact in integers, so this always ends, and at the Delaunay
// triangulation.
#include "docdepth/surface/delaunay.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace docdepth {
namespace {

// The cylinder is unrolled onto the plane with this much of either end repeated beyond the other.
constexpr std::int32_t kOverlap = kTurn / 24;
constexpr std::int32_t kLimit = kTurn / 2 + kOverlap + kTurn / 360;

struct Vertex {
  std::int32_t x, y;
  std::uint32_t number;  // of the return; guards continue the numbering
};

bool same(const Vertex& a, const Vertex& b) {
  return a.x == b.x && a.y == b.y;
}
bool before(const Vertex& a, const Vertex& b) {
  return a.x != b.x ? a.x < b.x : a.y < b.y;
}
bool ahead(const Vertex& a, const Vertex& b) {
  return same(a, b) ? a.number < b.number : before(a, b);
}

/// Twice the area of a, b, c: positive when they turn counterclockwise.
std::int64_t orientation(const Vertex& a, const Vertex& b, const Vertex& c) {
  return std::int64_t{b.x - a.x} * (c.y - a.y) - std::int64_t{b.y - a.y} * (c.x - a.x);
}

template <class Integer>
int in_circle_sign(std::int64_t ax, std::int64_t ay, std::int64_t bx, std::int64_t by,
                   std::int64_t cx, std::int64_t cy) {
  const Integer a = ax * ax + ay * ay, b = bx * bx + by * by, c = cx * cx + cy * cy;
  const Integer det = a * (bx * cy - by * cx) + b * (cx * ay - cy * ax) + c * (ax * by - ay * bx);
  return det > 0 ? 1 : det < 0 ? -1 : 0;
}

__extension__ typedef __int128 Wide;

/// Is d inside the circle through a, b, c (counterclockwise)? On the circle the edge must touch the
/// lowest number, as if its return were lifted off the paraboloid downwards the most.
bool must_flip(const Vertex& a, const Vertex& b, const Vertex& c, const Vertex& d) {
  const std::int64_t ax = a.x - d.x, ay = a.y - d.y, bx = b.x - d.x, by = b.y - d.y;
  const std::int64_t cx = c.x - d.x, cy = c.y - d.y;
  const std::int64_t extent =
      (std::abs(ax) | std::abs(ay) | std::abs(bx) | std::abs(by) | std::abs(cx) | std::abs(cy));
  const int sign = extent < (1 << 14) ? in_circle_sign<std::int64_t>(ax, ay, bx, by, cx, cy)
                                      : in_circle_sign<Wide>(ax, ay, bx, by, cx, cy);
  if (sign != 0) return sign > 0;
  return std::min(c.number, d.number) < std::min(a.number, b.number);
}

constexpr std::uint32_t kOpenChain = 0x80000000;  // marks an edge of a chain instead of a half edge

class Mesh {
 public:
  Mesh(const std::vector<Direction>& directions, const std::vector<std::uint32_t>& numbers);
  Triangulation triangles(std::size_t returns) const;

 private:
  void lay_out(const std::vector<Direction>& directions, const std::vector<std::uint32_t>& numbers);
  void join(std::size_t lower, std::size_t upper);
  std::uint32_t add(std::uint32_t a, std::uint32_t b, std::uint32_t c);
  void link(std::uint32_t e, std::uint32_t f);
  void use(std::uint32_t line, std::uint32_t e);
  void legalize();

  static std::uint32_t next(std::uint32_t e) { return e % 3 == 2 ? e - 2 : e + 1; }
  static std::uint32_t previous(std::uint32_t e) { return e % 3 == 0 ? e + 2 : e - 1; }

  std::vector<Vertex> vertices_;
  std::vector<std::uint32_t> strip_begin_;  // of the non-empty strips, and the end
  std::vector<std::uint32_t> start_;        // start vertex of each half edge, three a triangle
  std::vector<std::uint32_t> twin_;         // the other half of the edge, kNone at the border
  std::vector<std::uint32_t> below_;        // half edge below vertex k and the next of its strip

  struct Open {
    std::uint32_t vertex;
    std::uint32_t line;  // to the vertex before on the stack; what use() takes
  };
  std::vector<Open> stack_;
};

Mesh::Mesh(const std::vector<Direction>& directions, const std::vector<std::uint32_t>& numbers) {
  lay_out(directions, numbers);
  start_.reserve(6 * vertices_.size());
  twin_.reserve(6 * vertices_.size());
  below_.assign(vertices_.size(), kNone);
  for (std::size_t s = 0; s + 2 < strip_begin_.size(); ++s) join(s, s + 1);
  legalize();
}

void Mesh::lay_out(const std::vector<Direction>& directions,
                   const std::vector<std::uint32_t>& numbers) {
  std::int32_t low = kTurn, high = -kTurn, left = kTurn, right = -kTurn;
  for (const auto n : numbers) {
    low = std::min(low, directions[n].elevation);
    high = std::max(high, directions[n].elevation);
    left = std::min(left, directions[n].azimuth);
    right = std::max(right, directions[n].azimuth);
  }
  // Twice as high as the returns would be apart if they were spread evenly: about a ring or two.
  // Measured on HDL-64: half of that makes six times the flips, twice of that half as many more.
  const double area = (high - low + 1.0) * (right - left + 1.0);
  const auto height =
      std::max<std::int32_t>(1, std::lround(2.0 * std::sqrt(area / numbers.size())));
  // Guards stand so far out that they take only slivers from the border.
  const std::int32_t guard_distance = std::max(kTurn / 360, 2 * height);
  const std::size_t strips = (high - low) / height + 1;

  // Counting sort by strip, then radix sort of each strip by azimuth.
  std::vector<std::uint32_t> count(strips + 1, 0);
  const auto each_copy = [&](auto&& visit) {
    for (const auto n : numbers) {
      const Direction d = directions[n];
      visit(Vertex{d.azimuth, d.elevation, n});
      if (d.azimuth < -kTurn / 2 + kOverlap) visit(Vertex{d.azimuth + kTurn, d.elevation, n});
      if (d.azimuth >= kTurn / 2 - kOverlap) visit(Vertex{d.azimuth - kTurn, d.elevation, n});
    }
  };
  each_copy([&](const Vertex& v) { ++count[(v.y - low) / height + 1]; });
  for (std::size_t s = 0; s < strips; ++s) count[s + 1] += count[s];
  std::vector<Vertex> sorted(count[strips]);
  auto position = count;
  each_copy([&](const Vertex& v) { sorted[position[(v.y - low) / height]++] = v; });

  auto guard = static_cast<std::uint32_t>(directions.size());
  const auto guard_row = [&](std::int32_t y) {
    strip_begin_.push_back(static_cast<std::uint32_t>(vertices_.size()));
    for (std::int32_t x = -kLimit; x < kLimit; x += guard_distance)
      vertices_.push_back({x, y, guard++});
    vertices_.push_back({kLimit, y, guard++});
  };
  vertices_.reserve(sorted.size() + 2 * strips + 4 * kLimit / guard_distance + 4);
  guard_row(low - guard_distance);
  for (std::size_t s = 0; s < strips; ++s) {
    if (count[s] == count[s + 1]) continue;
    const auto middle = low + static_cast<std::int32_t>(s) * height + height / 2;
    const auto begin = sorted.begin() + count[s];
    std::sort(begin, sorted.begin() + count[s + 1], ahead);
    const auto end = std::unique(begin, sorted.begin() + count[s + 1], same);
    strip_begin_.push_back(static_cast<std::uint32_t>(vertices_.size()));
    vertices_.push_back({-kLimit, middle, guard++});
    vertices_.insert(vertices_.end(), begin, end);
    vertices_.push_back({kLimit, middle, guard++});
  }
  guard_row(high + guard_distance);
  strip_begin_.push_back(static_cast<std::uint32_t>(vertices_.size()));
}

std::uint32_t Mesh::add(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
  const auto e = static_cast<std::uint32_t>(start_.size());
  start_.insert(start_.end(), {a, b, c});
  twin_.insert(twin_.end(), {kNone, kNone, kNone});
  return e;
}

void Mesh::link(std::uint32_t e, std::uint32_t f) {
  if (e != kNone) twin_[e] = f;
  if (f != kNone) twin_[f] = e;
}

/// Take note that half edge e lies on `line`: a half edge made before (its twin), or an edge of a
/// chain whose upper side is still to come.
void Mesh::use(std::uint32_t line, std::uint32_t e) {
  if (line == kNone) return;
  if (line & kOpenChain) {
    below_[line & ~kOpenChain] = e;
  } else {
    twin_[line] = e;
    twin_[e] = line;
  }
}

/// Triangulate between two neighbouring strips: their chains bound a polygon that every vertical
/// line meets once, so one pass with a stack does (Garey et al. 1978).
void Mesh::join(std::size_t lower, std::size_t upper) {
  std::uint32_t i = strip_begin_[lower], j = strip_begin_[upper];
  const std::uint32_t i_end = strip_begin_[lower + 1], j_end = strip_begin_[upper + 1];
  stack_.assign({{i++, kNone}, {j++, kNone}});
  bool top_on_upper = true;
  while (i < i_end || j < j_end) {
    const bool on_upper = i == i_end || (j < j_end && before(vertices_[j], vertices_[i]));
    const std::uint32_t v = on_upper ? j++ : i++;
    // The chain's edge that ends at v.
    std::uint32_t line = on_upper ? (kOpenChain | (v - 1)) : below_[v - 1];
    if (on_upper == top_on_upper) {
      // Cut off the corners of the chain that v sees.
      while (stack_.size() >= 2) {
        const Open mid = stack_.back(), far = stack_[stack_.size() - 2];
        const auto turn = orientation(vertices_[far.vertex], vertices_[mid.vertex], vertices_[v]);
        if (on_upper ? turn >= 0 : turn <= 0) break;
        const std::uint32_t e = on_upper ? add(v, mid.vertex, far.vertex)   // v-mid, mid-far, far-v
                                         : add(v, far.vertex, mid.vertex);  // v-far, far-mid, mid-v
        use(mid.line, e + 1);
        use(line, on_upper ? e : e + 2);
        line = on_upper ? e + 2 : e;
        stack_.pop_back();
      }
      stack_.push_back({v, line});
    } else {
      // v sees all that is open of the other chain; `line` leads to the first of it.
      for (std::size_t k = 0; k + 1 < stack_.size(); ++k) {
        const std::uint32_t far = stack_[k].vertex, mid = stack_[k + 1].vertex;
        const std::uint32_t e = on_upper ? add(v, far, mid)   // v-far, far-mid, mid-v
                                         : add(v, mid, far);  // v-mid, mid-far, far-v
        use(stack_[k + 1].line, e + 1);
        use(line, on_upper ? e : e + 2);
        line = on_upper ? e + 2 : e;
      }
      stack_.assign({{stack_.back().vertex, kNone}, {v, line}});
    }
    top_on_upper = on_upper;
  }
}

/// Lawson's flips, until no edge asks for one.
void Mesh::legalize() {
  std::vector<std::uint32_t> todo;
  for (std::uint32_t first = 0; first < start_.size(); ++first) {
    if (twin_[first] == kNone || twin_[first] < first) continue;
    todo.push_back(first);
    while (!todo.empty()) {
      const std::uint32_t e = todo.back(), f = twin_[e];
      todo.pop_back();
      if (f == kNone) continue;
      const std::uint32_t en = next(e), ep = previous(e), fn = next(f), fp = previous(f);
      const std::uint32_t a = start_[e], b = start_[f], c = start_[ep], d = start_[fp];
      if (!must_flip(vertices_[a], vertices_[b], vertices_[c], vertices_[d])) continue;
      // a b c and b a d become d b c and c a d.
      start_[e] = d;
      start_[f] = c;
      link(e, twin_[fp]);
      link(f, twin_[ep]);
      link(ep, fp);
      todo.insert(todo.end(), {e, en, f, fn});
    }
  }
}

Triangulation Mesh::triangles(std::size_t returns) const {
  // Of the copies of a triangle near the seam the one whose leftmost corner is no copy is kept.
  const auto kept = [&](std::uint32_t t) {
    std::int32_t left = kTurn;
    for (int i = 0; i < 3; ++i) {
      const Vertex& v = vertices_[start_[3 * t + i]];
      if (v.number >= returns) return false;
      left = std::min(left, v.x);
    }
    return left >= -kTurn / 2 && left < kTurn / 2;
  };
  const auto count = static_cast<std::uint32_t>(start_.size() / 3);
  std::vector<std::uint32_t> renamed(count, kNone);
  Triangulation result;
  result.corners.reserve(count);
  result.across.reserve(count);
  for (std::uint32_t t = 0; t < count; ++t) {
    if (!kept(t)) continue;
    renamed[t] = static_cast<std::uint32_t>(result.corners.size());
    result.corners.push_back({vertices_[start_[3 * t]].number, vertices_[start_[3 * t + 1]].number,
                              vertices_[start_[3 * t + 2]].number});
  }
  // At the seam the neighbour that is kept is another copy; the pairs find each other by name.
  std::vector<std::array<std::uint32_t, 4>> seam;  // the edge's two returns, triangle, edge
  for (std::uint32_t t = 0; t < count; ++t) {
    if (renamed[t] == kNone) continue;
    std::array<std::uint32_t, 3> across = {kNone, kNone, kNone};
    for (std::uint32_t i = 0; i < 3; ++i) {
      const std::uint32_t f = twin_[3 * t + i];
      if (f != kNone) across[i] = renamed[f / 3];
      if (across[i] != kNone) continue;
      const auto a = vertices_[start_[3 * t + i]].number;
      const auto b = vertices_[start_[3 * t + (i + 1) % 3]].number;
      seam.push_back({std::min(a, b), std::max(a, b), renamed[t], i});
    }
    result.across.push_back(across);
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
  return Mesh(directions, numbers).triangles(directions.size());
}

}  // namespace docdepth
