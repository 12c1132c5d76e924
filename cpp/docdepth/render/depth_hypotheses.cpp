#include "docdepth/render/depth_hypotheses.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <utility>

#include "docdepth/geometry/simd.hpp"
#include "docdepth/render/shutter_rays.hpp"
#include "docdepth/render/visibility_queries.hpp"

namespace docdepth {
namespace {

/// Depths that differ by a smaller share are one surface.
constexpr float kSameDepth = 0.04f;
/// An edge is a second difference of inverse depth (0 on every plane) above this share of it.
constexpr float kEdgeBend = 0.05f;

// Scores as of VisibilityQueries [1/m^2].

/// One ray whose distance and blur add up to 10 cm, or many farther off. With a higher score a
/// surface is extrapolated over an edge.
constexpr float kCloseScore = 100.0f;
/// Pixels at edges with a lower score are left empty: no ray within 25 cm, blur included.
constexpr float kMinEdgeScore = 15.0f;
/// Rays that pass this far behind a measured surface of an object contradict it [m]. Nearer, a ray
/// may have passed just above a roof that it saw at a grazing angle.
constexpr float kWithinObject = 0.15f;
/// They do with a score below this, without its sign: five rays within a few centimetres, or more
/// farther off. Then what is behind is seen.
constexpr float kContradictedScore = 2000.0f;
/// With a score below this, without its sign, nobody knows: two rays within 2 cm, or more farther
/// off. Glass returns some rays and lets others pass.
constexpr float kDoubtedScore = 400.0f;
/// Where an object is extrapolated beyond its returns, pixels show it with a score above this: one
/// ray whose distance and blur add up to 14 cm, or more farther off.
constexpr float kContinuedScore = 50.0f;
/// They show what is behind only with a score below this, without its sign: a ray that passed
/// within 2 cm, its blur not included, or some farther off. Nearer to the object its outline may
/// lie beyond them.
constexpr float kUnsureScore = 200.0f;

static_assert(kLanes == DepthHypotheses::kTile, "a row of a tile is one vector");
static_assert(DepthHypotheses::kStrip % DepthHypotheses::kTile == 0, "strips are of whole tiles");

/// Add the depths of eight pixels to their hypotheses, where they differ from those.
template <class Each>
DOCDEPTH_KERNEL void add_row(float* inverse_depth, const Each& hypotheses) {
  constexpr float more = 1 + kSameDepth, less = 1 / (1 + kSameDepth);
  const Floats w = load(inverse_depth);
  store(Floats{}, inverse_depth);
  Ints left = w > 0.0f;
  for (int k = 0; k < DepthHypotheses::kMost && any(left); ++k) {
    Floats known = load(hypotheses(k));
    const Ints empty = left & (known == 0.0f);
    known = empty ? w : known;
    store(known, hypotheses(k));
    left &= ~((w < known * more) & (w > known * less));
  }
}

struct AddRows {
  DOCDEPTH_KERNEL static void run(float* inverse_depth,
                                  const std::array<float*, DepthHypotheses::kMost>& hypotheses,
                                  int stride, int rows) {
    for (int v = 0; v < rows; ++v) {
      const std::size_t at = std::size_t(v) * stride;
      add_row(inverse_depth + at, [&](int k) { return hypotheses[k] + at; });
    }
  }
};

/// Pixels [begin_u, end_u) x [begin_v, end_v).
struct Tile {
  int begin_u, end_u, begin_v, end_v;

  Tile(const Columns& columns, int u, int v)
      : begin_u(u * DepthHypotheses::kTile),
        end_u(std::min(begin_u + DepthHypotheses::kTile, columns.width)),
        begin_v(v * DepthHypotheses::kTile),
        end_v(std::min(begin_v + DepthHypotheses::kTile, columns.height)) {}
};

int tiles_along(int pixels) {
  return (pixels + DepthHypotheses::kTile - 1) / DepthHypotheses::kTile;
}

/// Whether a tile has an empty pixel or an edge, also one to the next tile of its strip.
bool has_edge(const Columns& columns, const std::vector<float>& inverse_depth, const Tile& tile) {
  const auto bent = [](float before, float here, float after) {
    return !(std::fabs((before - here) - (here - after)) <= kEdgeBend * here);
  };
  const auto ends_at = [&](int u) {
    return u % DepthHypotheses::kStrip == 0 || u == columns.width;
  };
  const int left = tile.begin_u + ends_at(tile.begin_u), right = tile.end_u - ends_at(tile.end_u);
  for (int v = tile.begin_v; v < tile.end_v; ++v)
    for (int u = tile.begin_u; u < tile.end_u; ++u) {
      const float* at = &inverse_depth[columns.at(u, v)];
      if (!(*at > 0)) return true;
      if (u >= left && u < right && bent(at[-1], at[0], at[1])) return true;
      if (v > 0 && v + 1 < columns.height && bent(at[-columns.stride], at[0], at[columns.stride]))
        return true;
    }
  return false;
}

/// 1 for each tile, row after row, with an edge or an empty pixel.
std::vector<std::uint8_t> edge_tiles(const Columns& columns,
                                     const std::vector<float>& inverse_depth) {
  std::vector<std::uint8_t> edges;
  for (int v = 0; v < tiles_along(columns.height); ++v)
    for (int u = 0; u < tiles_along(columns.width); ++u)
      edges.push_back(has_edge(columns, inverse_depth, Tile(columns, u, v)));
  return edges;
}

/// Which of eight pixels of a tile border on another surface or an empty pixel of the tile.
DOCDEPTH_KERNEL Ints edges_of_row(const float* inverse_depth, int stride, bool above, bool below) {
  constexpr float more = 1 + kSameDepth;
  const float none[kLanes] = {};
  float wide[kLanes + 2] = {};
  const Floats here = load(inverse_depth);
  store(here, wide + 1);
  const Floats around[] = {load(wide), load(wide + 2), load(above ? inverse_depth - stride : none),
                           load(below ? inverse_depth + stride : none)};
  Ints edges{};
  for (const Floats& other : around)
    edges |= (other > here * more) | ((other > 0.0f) & (other * more < here));
  return edges;
}

/// Pixels at an edge between two pixels of a tile, with their depth.
std::vector<PixelHypotheses> find_edges(const Columns& columns, const std::vector<Tile>& tiles,
                                        const std::vector<float>& inverse_depth) {
  std::vector<PixelHypotheses> found;
  for (const Tile& tile : tiles)
    for (int v = tile.begin_v; v < tile.end_v; ++v) {
      const std::size_t row = columns.at(tile.begin_u, v);
      const Ints edges =
          edges_of_row(&inverse_depth[row], columns.stride, v > tile.begin_v, v + 1 < tile.end_v);
      if (!any(edges)) continue;
      for (int lane = 0; lane < tile.end_u - tile.begin_u; ++lane)
        if (edges[lane]) found.push_back({tile.begin_u + lane, v, {inverse_depth[row + lane]}});
    }
  return found;
}

/// Empty pixels that a nearer surface may hide, which goes on beyond its last return.
void empty_hidden(const Columns& columns, const std::vector<float>& extrapolated,
                  const VisibilityQueries& queries, std::vector<float>& inverse_depth,
                  std::vector<float>& scores) {
  std::vector<PixelHypotheses> nearer;
  for (int v = 0; v < columns.height; ++v)
    for (int u = 0; u < columns.width; ++u) {
      const std::size_t at = columns.at(u, v);
      if (inverse_depth[at] > 0 && extrapolated[at] > inverse_depth[at] * (1 + kSameDepth))
        nearer.push_back({u, v, {extrapolated[at]}});
    }
  const std::vector<float> found = queries.score(nearer, 0);
  for (std::size_t i = 0; i < nearer.size(); ++i) {
    const std::size_t at = columns.at(nearer[i].u, nearer[i].v);
    if (found[i] > 0) inverse_depth[at] = scores[at] = 0;
  }
}

/// Move edges to where rays confirm them, and empty what no ray confirms.
///
/// A surface ends at its last return, but the object goes on for up to a pixel. A pixel next to a
/// nearer surface takes its depth if rays confirm that, with a higher score than the pixel's own.
void move_edges(const Columns& columns, const std::vector<Tile>& tiles,
                const VisibilityQueries& queries, std::vector<float>& inverse_depth,
                std::vector<float>& scores) {
  const auto at = [&](const PixelHypotheses& pixel) { return columns.at(pixel.u, pixel.v); };
  const std::vector<PixelHypotheses> edges = find_edges(columns, tiles, inverse_depth);
  std::vector<PixelHypotheses> queried;
  for (const PixelHypotheses& edge : edges)
    if (edge.hypotheses[0] == 0)
      scores[at(edge)] = 0;
    else if (std::isinf(scores[at(edge)]))
      queried.push_back(edge);
  std::vector<float> found = queries.score(queried, 0, kCloseScore);
  for (std::size_t i = 0; i < queried.size(); ++i) scores[at(queried[i])] = found[i];

  queried.clear();
  for (const PixelHypotheses& edge : edges) {
    const auto [u, v] = std::pair(edge.u, edge.v);
    float nearest = 0;
    const auto look = [&](std::size_t i) {
      if (scores[i] >= kMinEdgeScore) nearest = std::max(nearest, inverse_depth[i]);
    };
    if (u % DepthHypotheses::kTile > 0) look(columns.at(u - 1, v));
    if (u % DepthHypotheses::kTile + 1 < DepthHypotheses::kTile) look(columns.at(u + 1, v));
    if (v % DepthHypotheses::kTile > 0) look(columns.at(u, v - 1));
    if (v % DepthHypotheses::kTile + 1 < DepthHypotheses::kTile && v + 1 < columns.height)
      look(columns.at(u, v + 1));
    if (nearest > edge.hypotheses[0] * (1 + kSameDepth) && scores[at(edge)] < kSureSurfaceScore)
      queried.push_back({u, v, {nearest}});
  }
  found = queries.score(queried, 0, kCloseScore);
  for (std::size_t i = 0; i < queried.size(); ++i)
    if (found[i] > std::max(kCloseScore, scores[at(queried[i])]))
      inverse_depth[at(queried[i])] = queried[i].hypotheses[0], scores[at(queried[i])] = found[i];
  for (std::size_t i = 0; i < scores.size(); ++i)
    if (scores[i] < kMinEdgeScore) inverse_depth[i] = 0;
}

}  // namespace

DepthHypotheses::DepthHypotheses(const Columns& columns, std::vector<float> nearest,
                                 std::vector<float> extrapolated)
    : columns_(columns),
      tiles_(tiles_along(columns.width)),
      open_(edge_tiles(columns, nearest)),
      extrapolated_(std::move(extrapolated)) {
  for (int k = 1; k < kMost; ++k) hypotheses_[k].assign(nearest.size(), 0.0f);
  hypotheses_[0] = std::move(nearest);
}

void DepthHypotheses::add(float* inverse_depth) {
  for (std::size_t tile = 0; tile < open_.size(); ++tile) {
    if (!open_[tile]) continue;
    const int u = int(tile) % tiles_ * kTile, v = int(tile) / tiles_ * kTile;
    const std::size_t at = columns_.at(u, v);
    std::array<float*, kMost> rows;
    for (int k = 0; k < kMost; ++k) rows[k] = hypotheses_[k].data() + at;
    dispatch<AddRows>(inverse_depth + at, rows, columns_.stride,
                      std::min(kTile, columns_.height - v));
  }
}

std::vector<float> DepthHypotheses::resolve(const Camera& camera,
                                            const std::vector<SweepRays>& rays) const {
  std::vector<float> result = hypotheses_[0];
  if (rays.empty()) return result;
  std::vector<Tile> tiles;
  for (int i = 0; i < int(open_.size()); ++i)
    if (open_[i]) tiles.emplace_back(columns_, i % tiles_, i / tiles_);
  std::vector<PixelHypotheses> pixels;
  for (const Tile& tile : tiles)
    for (int v = tile.begin_v; v < tile.end_v; ++v)
      for (int u = tile.begin_u; u < tile.end_u; ++u) {
        const std::size_t at = columns_.at(u, v);
        if (!(hypotheses_[1][at] > 0)) continue;
        PixelHypotheses pixel{u, v, {}};
        for (int k = 0; k < kMost; ++k) pixel.hypotheses[k] = hypotheses_[k][at];
        result[at] = 0;
        std::sort(pixel.hypotheses, pixel.hypotheses + kMost, std::greater<float>());
        pixels.push_back(pixel);
      }
  const VisibilityQueries queries(columns_.begin, camera, rays);
  std::vector<float> scores(result.size(),
                            INFINITY);  // of the result; infinite while it was not queried
  for (int k = 0; k < kMost && !pixels.empty(); ++k) {
    const std::vector<float> found = queries.score(pixels, k);
    std::size_t left = 0;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      const PixelHypotheses pixel = pixels[i];
      const std::size_t at = columns_.at(pixel.u, pixel.v);
      if (found[i] > 0 || (found[i] == 0 && result[at] == 0)) {
        result[at] = pixel.hypotheses[k];
        scores[at] = found[i];
      }
      if (!(found[i] > 0) && k + 1 < kMost && pixel.hypotheses[k + 1] > 0) pixels[left++] = pixel;
    }
    pixels.resize(left);
  }
  empty_hidden(columns_, extrapolated_, queries, result, scores);
  if (rays.size() == 1) return result;  // one sweep only confirms itself
  move_edges(columns_, tiles, queries, result, scores);
  return result;
}

void add_dynamic_object(const Columns& columns, const PixelBounds& bounds, const Camera& camera,
                        const ObjectImages& object, const std::vector<SweepRays>& rays,
                        std::uint16_t number, std::vector<float>& inverse_depth,
                        std::vector<std::uint16_t>& shown_objects) {
  const VisibilityQueries queries(columns.begin, camera, rays);
  std::vector<PixelHypotheses> seen, extrapolated;
  for (int v = bounds.begin_v; v < bounds.end_v; ++v)
    for (int u = bounds.begin_u; u < bounds.end_u; ++u) {
      const std::size_t at = columns.at(u, v);
      const float nearest = object.nearest[at], other = object.others[at];
      const float beyond = object.extrapolated[at], here = inverse_depth[at];
      if (nearest > 0) {
        if (nearest > here) {
          inverse_depth[at] = nearest;
          shown_objects[at] = number;
        }
      } else if (other > here)
        seen.push_back({u, v, {other, beyond}});
      else if (beyond > here)
        extrapolated.push_back({u, v, {beyond}});
    }
  std::vector<PixelHypotheses> behind = seen;
  for (PixelHypotheses& pixel : behind)
    pixel.hypotheses[0] = 1 / (1 / pixel.hypotheses[0] + kWithinObject);
  // Rays of the sweeps nearest in time come first: what they pass through is doubted, whatever
  // others say.
  std::vector<float> found = queries.score(behind, 0, kDoubtedScore);
  std::vector<PixelHypotheses> doubted;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const auto& [u, v, depths] = seen[i];
    const std::size_t at = columns.at(u, v);
    if (found[i] > -kDoubtedScore) {
      inverse_depth[at] = depths[0];
      shown_objects[at] = number;
    } else
      doubted.push_back(behind[i]);
  }
  found = queries.score(doubted, 0, kContradictedScore);
  for (std::size_t i = 0; i < doubted.size(); ++i) {
    const auto& [u, v, depths] = doubted[i];
    const std::size_t at = columns.at(u, v);
    if (found[i] > -kContradictedScore) {
      inverse_depth[at] = 0;
      shown_objects[at] = 0;
    } else if (depths[1] > inverse_depth[at])
      extrapolated.push_back({u, v, {depths[1]}});
  }
  found = queries.score(extrapolated, 0);
  const ShutterRays around(rays);
  const auto passed_all_around = [&](const PixelHypotheses& pixel) {
    const auto u = float(pixel.u + columns.begin), v = float(pixel.v);
    const QuadrantRays corners =
        around.around({ray_of(camera, u, v) / pixel.hypotheses[0], Kind::kMoving});
    return count(corners, {Verdict::kPassed}) == int(corners.size());
  };
  for (std::size_t i = 0; i < extrapolated.size(); ++i) {
    const std::size_t at = columns.at(extrapolated[i].u, extrapolated[i].v);
    if (found[i] > kContinuedScore) {
      inverse_depth[at] = extrapolated[i].hypotheses[0];
      shown_objects[at] = number;
    } else if (found[i] > -kUnsureScore && !passed_all_around(extrapolated[i])) {
      inverse_depth[at] = 0;
      shown_objects[at] = 0;
    }
  }
}

}  // namespace docdepth
