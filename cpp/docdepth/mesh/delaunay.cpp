// The returns of a sweep lie in rings. So the directions are put into chains, ring by ring where
// there are rings, in flat strips where not. Neighbouring chains are triangulated in linear time,
// and edge flips (Lawson) finish the Delaunay triangulation. All predicates are exact in integers,
// so the flips always end, and the result does not depend on the chains.
//
// Why not a library: labels and depth have to be the same on every machine, and integers make the
// triangulation exact and unique. General libraries do not use that returns lie in rings: Qhull, by
// scipy, takes 1.2 s for the 130,000 returns of a sweep.
#include "docdepth/mesh/delaunay.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <utility>

#include "docdepth/geometry/simd.hpp"
#include "docdepth/mesh/direction_chains.hpp"

namespace docdepth {
namespace {

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

DOCDEPTH_KERNEL Floats difference(const std::int32_t* a, const std::int32_t* b) {
  return __builtin_convertvector(load<Ints>(a) - load<Ints>(b), Floats);
}

/// Finds the edges of some triangles that may not be Delaunay, eight at a time. is_within in single
/// precision, whose error is far below the share kUnsure of the terms.
struct FindDoubtful {
  static constexpr float kUnsure = 1e-5f;

  DOCDEPTH_KERNEL static void run(const Triangulation& triangles, std::size_t first,
                                  const Vertex* vertices, std::vector<std::uint32_t>& doubtful) {
    std::uint32_t edges[kLanes] = {};
    std::int32_t x[4][kLanes] = {}, y[4][kLanes] = {};
    int lane = 0;
    for (std::size_t t = first; t < triangles.size(); ++t) {
      const auto& [corners, across] = triangles[t];
      for (std::uint32_t i = 0; i < 3; ++i) {
        const auto e = static_cast<std::uint32_t>(8 * t) + i;
        const std::uint32_t f = across[i];
        if (f > e) continue;  // it is tested from the other side
        const std::uint32_t j = f % 4;
        const std::uint32_t of[] = {corners[i], corners[i == 2 ? 0 : i + 1],
                                    corners[i == 0 ? 2 : i - 1],
                                    triangles[f / 8].corners[j == 0 ? 2 : j - 1]};
        for (int k = 0; k < 4; ++k) {
          x[k][lane] = vertices[of[k]].x;
          y[k][lane] = vertices[of[k]].y;
        }
        edges[lane] = e;
        if (++lane == kLanes) {
          test(x, y, edges, lane, doubtful);
          lane = 0;
        }
      }
    }
    test(x, y, edges, lane, doubtful);
  }

  DOCDEPTH_KERNEL static void test(const std::int32_t (&x)[4][kLanes],
                                   const std::int32_t (&y)[4][kLanes], const std::uint32_t* edges,
                                   int count, std::vector<std::uint32_t>& doubtful) {
    const Floats cax = difference(x[0], x[2]), cay = difference(y[0], y[2]);
    const Floats cbx = difference(x[1], x[2]), cby = difference(y[1], y[2]);
    const Floats dax = difference(x[0], x[3]), day = difference(y[0], y[3]);
    const Floats dbx = difference(x[1], x[3]), dby = difference(y[1], y[3]);
    const Floats sine_c = cax * cby - cay * cbx, cosine_c = cax * cbx + cay * cby;
    const Floats sine_d = dbx * day - dby * dax, cosine_d = dax * dbx + day * dby;
    const Floats size_c = (absolute(cax) + absolute(cay)) * (absolute(cbx) + absolute(cby));
    const Floats size_d = (absolute(dax) + absolute(day)) * (absolute(dbx) + absolute(dby));
    const Ints unsure = sine_c * cosine_d + cosine_c * sine_d <= kUnsure * size_c * size_d;
    if (!any(unsure)) return;
    for (int lane = 0; lane < count; ++lane)
      if (unsure[lane]) doubtful.push_back(edges[lane]);
  }
};

/// What lies beyond a half edge: its other half (below kOpen), or the link n - kOpen of the upper
/// chain, beyond which nothing is triangulated yet, or nothing (kNone).
constexpr std::uint32_t kOpen = 0x80000000;

class Triangulator {
 public:
  explicit Triangulator(Chains chains);
  Triangulation take(std::size_t returns);

 private:
  /// A vertex of a chain, and the half edge below the way to the next one.
  struct Link {
    std::uint32_t vertex, below;
  };
  struct Open {
    std::uint32_t vertex;
    std::uint32_t line;  // beyond the edge to the previous vertex on the stack
  };

  void raise(std::uint32_t begin, std::uint32_t end);
  void join(std::uint32_t lower, std::uint32_t lower_end, std::uint32_t upper,
            std::uint32_t upper_end);
  std::uint32_t connect(std::size_t open, std::uint32_t v, bool on_upper, std::uint32_t line);
  void insert(const Link& buried);
  void legalize(std::size_t first);
  void finish_flips();
  void flip(std::uint32_t e);
  std::uint32_t add(std::uint32_t a, std::uint32_t b, std::uint32_t c);
  void link(std::uint32_t e, std::uint32_t beyond);

  std::int64_t turn(std::uint32_t a, std::uint32_t b, std::uint32_t c) const {
    return orientation(vertices_[a], vertices_[b], vertices_[c]);
  }
  std::uint32_t* words() { return reinterpret_cast<std::uint32_t*>(triangles_.data()); }
  std::uint32_t& corner(std::uint32_t e) { return words()[e]; }
  std::uint32_t& across(std::uint32_t e) { return words()[e + 4]; }
  static std::uint32_t next(std::uint32_t e) { return e % 4 == 2 ? e - 2 : e + 1; }
  static std::uint32_t previous(std::uint32_t e) { return e % 4 == 0 ? e + 2 : e - 1; }

  std::vector<Vertex> vertices_;
  /// Of vertices and half edges until they are done. Half edge 8 t + i leads from corner i of
  /// triangle t to the next, counterclockwise: its number is that of a word.
  Triangulation triangles_;
  std::vector<Link> front_, upper_;  // the upper border of the triangles, and its next one
  std::vector<Link> buried_;         // vertices below the front, and a half edge near to each
  std::unique_ptr<Open[]> stack_;
  std::vector<std::uint32_t> doubtful_;  // half edges that may have to flip
};

Triangulator::Triangulator(Chains chains) : vertices_(std::move(chains.vertices)) {
  triangles_.reserve(2 * vertices_.size());
  stack_.reset(new Open[vertices_.size()]);
  for (auto v = chains.begin[0]; v < chains.begin[1]; ++v) front_.push_back({v, kNone});
  // One chain after the other, while it is in the cache.
  for (std::size_t c = 1; c + 1 < chains.begin.size(); ++c) {
    const std::size_t first = triangles_.size();
    raise(chains.begin[c], chains.begin[c + 1]);
    legalize(first);
    front_.swap(upper_);
  }
  front_.swap(upper_);
  for (const Link& buried : buried_) insert(buried);
}

/// Triangulate from the front to the next chain. Where the two cross, the new front goes by
/// vertices of the old one that lie above the chain, and vertices of the chain below the old front
/// have to wait: so nothing ever overlaps.
void Triangulator::raise(std::uint32_t begin, std::uint32_t end) {
  upper_.clear();
  const auto lower = static_cast<std::uint32_t>(front_.size());
  std::uint32_t i = 0, passed = 0;  // links of the front before v, and before `last`
  std::uint32_t last = begin;       // vertex of the chain
  std::uint32_t joined_lower = 0, joined_upper = 0;
  for (auto v = begin; v < end; ++v) {
    while (i < lower && !before(vertices_[v], vertices_[front_[i].vertex])) ++i;
    if (i < lower && turn(front_[i - 1].vertex, front_[i].vertex, v) <= 0) {
      buried_.push_back({v, front_[i - 1].below});
      continue;
    }
    for (; passed < i; ++passed) {
      const std::uint32_t f = front_[passed].vertex;
      if (v == begin || turn(last, v, f) < 0) continue;
      const auto place = static_cast<std::uint32_t>(upper_.size());
      upper_.push_back({f, kNone});
      join(joined_lower, passed, joined_upper, place);
      joined_lower = passed;
      joined_upper = place;
    }
    upper_.push_back({v, kNone});
    last = v;
  }
  join(joined_lower, lower - 1, joined_upper, static_cast<std::uint32_t>(upper_.size()) - 1);
}

std::uint32_t Triangulator::add(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
  triangles_.push_back({{a, b, c}, {kNone, kNone, kNone}});
  return 8 * (static_cast<std::uint32_t>(triangles_.size()) - 1);
}

/// Connect half edge e with what lies beyond it.
void Triangulator::link(std::uint32_t e, std::uint32_t beyond) {
  across(e) = beyond;
  if (beyond < kOpen)
    across(beyond) = e;
  else if (beyond != kNone)
    upper_[beyond - kOpen].below = e;
}

/// Connect v with all open vertices of the other chain.
/// @param line  beyond the edge from v to the first of them
/// @return beyond the edge from v to the last of them
std::uint32_t Triangulator::connect(std::size_t open, std::uint32_t v, bool on_upper,
                                    std::uint32_t line) {
  for (std::size_t k = 0; k + 1 < open; ++k) {
    const std::uint32_t far = stack_[k].vertex, mid = stack_[k + 1].vertex;
    const std::uint32_t e = on_upper ? add(v, far, mid)   // v-far, far-mid, mid-v
                                     : add(v, mid, far);  // v-mid, mid-far, far-v
    link(e + 1, stack_[k + 1].line);
    link(on_upper ? e : e + 2, line);
    line = on_upper ? e + 2 : e;
  }
  return line;
}

/// Triangulate between parts of the front and of the next one. Both begin at one vertex, or at the
/// first guard of each, and end at one vertex, or at the last guards. They bound a polygon that is
/// monotone in azimuth, so one pass with a stack suffices (Garey et al. 1978).
void Triangulator::join(std::uint32_t lower, std::uint32_t lower_end, std::uint32_t upper,
                        std::uint32_t upper_end) {
  const bool from_one = front_[lower].vertex == upper_[upper].vertex;
  const bool to_one = front_[lower_end].vertex == upper_[upper_end].vertex;
  if (from_one && to_one && lower_end == lower + 1 && upper_end == upper + 1) {
    if (front_[lower].below != kNone) link(front_[lower].below, kOpen | upper);
    return;
  }
  std::size_t open = 0;
  stack_[open++] = {front_[lower].vertex, kNone};
  if (!from_one) stack_[open++] = {upper_[upper].vertex, kNone};
  bool top_on_upper = true;
  std::uint32_t i = lower + 1, j = upper + 1;
  const std::uint32_t i_end = lower_end + !to_one, j_end = upper_end + !to_one;
  while (i < i_end || j < j_end) {
    const bool on_upper = i == i_end || (j < j_end && before(vertices_[upper_[j].vertex],
                                                             vertices_[front_[i].vertex]));
    // The edge of the way that ends at v.
    std::uint32_t line = on_upper ? kOpen | (j - 1) : front_[i - 1].below;
    const std::uint32_t v = on_upper ? upper_[j++].vertex : front_[i++].vertex;
    if (on_upper == top_on_upper) {
      // Cut off the corners of the way that are visible from v.
      while (open >= 2) {
        const Open mid = stack_[open - 1], far = stack_[open - 2];
        const auto corner = turn(far.vertex, mid.vertex, v);
        if (on_upper ? corner >= 0 : corner <= 0) break;
        const std::uint32_t e = on_upper ? add(v, mid.vertex, far.vertex)   // v-mid, mid-far, far-v
                                         : add(v, far.vertex, mid.vertex);  // v-far, far-mid, mid-v
        link(e + 1, mid.line);
        link(on_upper ? e : e + 2, line);
        line = on_upper ? e + 2 : e;
        --open;
      }
    } else {
      line = connect(open, v, on_upper, line);
      stack_[0] = {stack_[open - 1].vertex, kNone};
      open = 1;
    }
    stack_[open++] = {v, line};
    top_on_upper = on_upper;
  }
  if (!to_one) return;
  // The last vertex is of both ways; the open ones are of one.
  std::uint32_t below = front_[lower_end - 1].below, above = kOpen | (upper_end - 1);
  if (!top_on_upper) std::swap(below, above);
  link(connect(open, front_[lower_end].vertex, !top_on_upper, below), above);
}

/// Insert a vertex into the finished triangulation.
void Triangulator::insert(const Link& buried) {
  const std::uint32_t v = buried.vertex;
  std::uint32_t e = buried.below - buried.below % 8;
  for (std::uint32_t inside = 0; inside < 3;) {  // walk there
    if (turn(corner(e), corner(next(e)), v) < 0) {
      e = across(e);
      inside = 0;
    }
    e = next(e);
    ++inside;
  }
  for (std::uint32_t k = 0; k < 3; ++k, e = next(e)) {
    Vertex& w = vertices_[corner(e)];
    if (before(w, vertices_[v]) || before(vertices_[v], w)) continue;
    if (w.number < vertices_[v].number) return;
    // Of equal directions the first is taken, and by its row edges between equal angles are told.
    w.number = vertices_[v].number;
    std::uint32_t around = e;
    do {
      for (const auto edge : {around, next(around), previous(around)}) doubtful_.push_back(edge);
      around = across(previous(around));
    } while (around != e);
    finish_flips();
    return;
  }
  const std::uint32_t f = next(e), g = next(f);
  const std::uint32_t a = corner(e), b = corner(f), c = corner(g);
  // a b c becomes a b v, b c v and c a v.
  const std::uint32_t right = add(b, c, v), left = add(c, a, v);
  link(right, across(f));
  link(left, across(g));
  corner(g) = v;
  link(f, right + 2);
  link(right + 1, left + 2);
  link(left + 1, g);
  for (const auto outer : {right, left, e}) doubtful_.push_back(outer);
  finish_flips();
}

/// Flip edges (Lawson) until all edges of the triangles from `first` on are Delaunay, and all
/// others again.
void Triangulator::legalize(std::size_t first) {
  dispatch<FindDoubtful>(std::as_const(triangles_), first, vertices_.data(), doubtful_);
  finish_flips();
}

void Triangulator::finish_flips() {
  while (!doubtful_.empty()) {
    const std::uint32_t e = doubtful_.back();
    doubtful_.pop_back();
    flip(e);
  }
}

/// Flip an edge if it is not Delaunay; the four edges around it become doubtful.
inline void Triangulator::flip(std::uint32_t e) {
  const std::uint32_t f = across(e);
  if (f >= kOpen) return;
  const std::uint32_t ep = previous(e), fp = previous(f);
  const std::uint32_t a = corner(e), b = corner(f);
  const std::uint32_t c = corner(ep), d = corner(fp);
  if (!is_within(vertices_[a], vertices_[b], vertices_[c], vertices_[d])) return;
  // a b c and b a d become d b c and c a d.
  corner(e) = d;
  corner(f) = c;
  link(e, across(fp));
  link(f, across(ep));
  link(ep, fp);
  for (const auto outer : {e, next(e), f, next(f)}) doubtful_.push_back(outer);
}

/// Name vertices by the rows of their returns, and leave out guards and copies beyond the seam.
Triangulation Triangulator::take(std::size_t returns) {
  std::vector<std::uint32_t> renamed(triangles_.size(), kNone);
  std::uint32_t kept = 0;
  for (std::uint32_t t = 0; t < renamed.size(); ++t) {
    const auto& corners = triangles_[t].corners;
    const Vertex &a = vertices_[corners[0]], &b = vertices_[corners[1]], &c = vertices_[corners[2]];
    // A triangle near the seam has copies. The one whose leftmost corner is no copy is kept.
    const std::int32_t left = std::min(a.x, std::min(b.x, c.x));
    const bool is_copy = left < -kTurn / 2 || left >= kTurn / 2;
    if (is_copy || std::max(a.number, std::max(b.number, c.number)) >= returns) continue;
    triangles_[kept] = {{a.number, b.number, c.number}, triangles_[t].across};
    renamed[t] = kept++;
  }
  triangles_.resize(kept);
  // At the seam the neighbour that is kept is another copy, found by the rows of the edge.
  std::vector<std::array<std::uint32_t, 4>> seam;  // rows of the edge, triangle, edge
  for (std::uint32_t t = 0; t < kept; ++t) {
    auto& [corners, across] = triangles_[t];
    for (std::uint32_t i = 0; i < 3; ++i) {
      across[i] = across[i] < kOpen ? renamed[across[i] / 8] : kNone;
      if (across[i] != kNone) continue;
      const auto [a, b] = std::minmax(corners[i], corners[(i + 1) % 3]);
      seam.push_back({a, b, t, i});
    }
  }
  std::sort(seam.begin(), seam.end());
  for (std::size_t k = 0; k + 1 < seam.size(); ++k) {
    const auto &a = seam[k], &b = seam[k + 1];
    if (a[0] != b[0] || a[1] != b[1]) continue;
    triangles_[a[2]].across[a[3]] = b[2];
    triangles_[b[2]].across[b[3]] = a[2];
  }
  return std::move(triangles_);
}

}  // namespace

Triangulation triangulate(const std::vector<Direction>& directions,
                          const std::vector<std::uint32_t>& numbers) {
  if (numbers.size() < 3) return {};
  return Triangulator(make_chains(directions, numbers)).take(directions.size());
}

}  // namespace docdepth
