#include "docdepth/render/candidates.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <utility>

#include "docdepth/geometry/lanes.hpp"
#include "docdepth/geometry/rigid.hpp"
#include "docdepth/render/dispatch.hpp"

namespace docdepth {
namespace {

constexpr float kSame = 0.04f;  ///< offers that differ less are of one surface
constexpr float kEdge = 0.05f;  ///< bend of nearness, linear on every plane, as a share of it

/// A ray that passed within a centimetre, or many farther off, decide: no more are asked. It takes
/// more to have met something than to have gone through: that may be beside a gap.
constexpr float kSure = 1000.0f, kSurelyMet = 1350.0f;

/// Beside an edge a surface goes on where one ray met it within 8 cm, blur included 10, or many
/// farther off; what none met within 25 is left out.
constexpr float kGoesOn = 100.0f, kLeftOut = 15.0f;

/// What a mover has beyond its trusted surface is drawn where one ray met it within a decimetre,
/// blur included, or many farther off. Those that passed count half as much again: it is a guess.
constexpr float kMet = 100.0f, kPassedGuess = 1.5f;

static_assert(kLanes == Candidates::kTile, "a row of a tile is one vector");
static_assert(Candidates::kStrip % Candidates::kTile == 0, "strips are of whole tiles");

DOCDEPTH_INLINE bool any(const Ints& lanes) {
  std::int64_t halves[kLanes / 2];
  std::memcpy(halves, &lanes, sizeof lanes);
  return (halves[0] | halves[1] | halves[2] | halves[3]) != 0;
}

/// Adds what is new of eight pixels to their offers.
template <class Each>
DOCDEPTH_INLINE void take_row(float* nearness, const Each& offers) {
  constexpr float more = 1 + kSame, less = 1 / (1 + kSame);
  Floats w;
  std::memcpy(&w, nearness, sizeof w);
  const Floats none{};
  std::memcpy(nearness, &none, sizeof none);
  Ints left = w > 0.0f;
  for (int k = 0; k < Candidates::kMost && any(left); ++k) {
    Floats known;
    std::memcpy(&known, offers(k), sizeof known);
    const Ints empty = left & (known == 0.0f);
    known = empty ? w : known;
    std::memcpy(offers(k), &known, sizeof known);
    left &= ~((w < known * more) & (w > known * less));
  }
}

struct TakeRows {
  float* nearness;
  float* offers[Candidates::kMost];
  int stride, rows;

  DOCDEPTH_INLINE void run() const {
    for (int v = 0; v < rows; ++v) {
      const std::size_t at = std::size_t(v) * stride;
      take_row(nearness + at, [&](int k) { return offers[k] + at; });
    }
  }
};

DOCDEPTH_AVX2 void take_avx2(const TakeRows& rows) {
  rows.run();
}
void take_plain(const TakeRows& rows) {
  rows.run();
}

/// A pixel with different offers, the nearest first; 0 from the first unused.
struct Contest {
  int u, v;
  float offers[Candidates::kMost];
};

/// Pixels [begin_u, end_u) x [begin_v, end_v).
struct Tile {
  int begin_u, end_u, begin_v, end_v;

  Tile(const Columns& columns, int u, int v)
      : begin_u(u * Candidates::kTile),
        end_u(std::min(begin_u + Candidates::kTile, columns.width)),
        begin_v(v * Candidates::kTile),
        end_v(std::min(begin_v + Candidates::kTile, columns.height)) {}
};

int tiles_along(int pixels) {
  return (pixels + Candidates::kTile - 1) / Candidates::kTile;
}

/// Is there an empty pixel in a tile, or an edge, be it between the tile and the next of its strip?
bool has_edge(const Columns& columns, const std::vector<float>& nearness, const Tile& tile) {
  const auto bent = [](float before, float here, float after) {
    return !(std::fabs((before - here) - (here - after)) <= kEdge * here);
  };
  const auto ends_at = [&](int u) { return u % Candidates::kStrip == 0 || u == columns.width; };
  const int left = tile.begin_u + ends_at(tile.begin_u), right = tile.end_u - ends_at(tile.end_u);
  for (int v = tile.begin_v; v < tile.end_v; ++v)
    for (int u = tile.begin_u; u < tile.end_u; ++u) {
      const float* at = &nearness[columns.at(u, v)];
      if (!(*at > 0)) return true;
      if (u >= left && u < right && bent(at[-1], at[0], at[1])) return true;
      if (v > 0 && v + 1 < columns.height && bent(at[-columns.stride], at[0], at[columns.stride]))
        return true;
    }
  return false;
}

/// Of each tile, row after row, 1 where there is an edge or an empty pixel.
std::vector<std::uint8_t> edge_tiles(const Columns& columns, const std::vector<float>& nearness) {
  std::vector<std::uint8_t> edges;
  for (int v = 0; v < tiles_along(columns.height); ++v)
    for (int u = 0; u < tiles_along(columns.width); ++u)
      edges.push_back(has_edge(columns, nearness, Tile(columns, u, v)));
  return edges;
}

/// Which of eight pixels of a tile lie beside another surface in the tile, or beside none.
DOCDEPTH_INLINE Ints edges_of_row(const float* nearness, int stride, bool above, bool below) {
  constexpr float more = 1 + kSame;
  const float none[kLanes] = {};
  float wide[kLanes + 2] = {};
  std::memcpy(wide + 1, nearness, sizeof(Floats));
  const Floats here = load(nearness);
  const Floats around[] = {load(wide), load(wide + 2), load(above ? nearness - stride : none),
                           load(below ? nearness + stride : none)};
  Ints edges{};
  for (const Floats& beside : around)
    edges |= (beside > here * more) | ((beside > 0.0f) & (beside * more < here));
  return edges;
}

/// Asks the rays for the offers number k of pixels, until they surely met or passed them.
class Questions {
 public:
  Questions(const Columns& columns, const Camera& camera, const std::vector<PlacedRays>& rays)
      : focal_(camera.fx, camera.fy),
        centre_(float(camera.cx) - float(columns.begin), camera.cy),
        rays_(rays) {
    for (const auto& placed : rays) to_rays_.emplace_back(placed.T_camera_rays.inverse());
  }

  /// @param passed they surely did
  /// @param weight of rays that passed
  std::vector<float> ask(const std::vector<Contest>& contests, int k, float passed = kSure,
                         float weight = 1) const {
    std::vector<float> balance(contests.size(), 0.0f);
    for (std::size_t first = 0; first < contests.size(); first += Places::kMost)
      ask_some(&contests[first], std::min(contests.size() - first, Places::kMost), k, passed,
               weight, &balance[first]);
    return balance;
  }

 private:
  void ask_some(const Contest* contests, std::size_t count, int k, float passed, float weight,
                float* balance) const {
    Eigen::Vector3f places[Places::kMost];
    for (std::size_t i = 0; i < count; ++i) {
      const float depth = 1 / contests[i].offers[k];
      places[i] = {(float(contests[i].u) - centre_.x()) / focal_.x() * depth,
                   (float(contests[i].v) - centre_.y()) / focal_.y() * depth, depth};
    }
    std::uint32_t open[Places::kMost];  // what is not sure yet
    for (std::uint32_t i = 0; i < count; ++i) open[i] = i;
    float told[Places::kMost] = {};
    Places seen;
    seen.size = count;
    for (std::size_t j = 0; j < rays_.size() && seen.size > 0; ++j) {
      for (std::size_t n = 0; n < seen.size; ++n) {
        const Eigen::Vector3f p = to_rays_[j] * places[open[n]];
        seen.x[n] = p.x(), seen.y[n] = p.y(), seen.z[n] = p.z();
      }
      rays_[j].rays->ask(seen, rays_[j].blur, told);
      std::size_t left = 0;
      for (std::size_t n = 0; n < seen.size; ++n) {
        float& known = balance[open[n]];
        if (told[n] < known) told[n] += (weight - 1) * (told[n] - known);
        known = told[n];
        if (told[n] >= kSurelyMet || told[n] <= -passed) continue;
        open[left] = open[n], told[left++] = told[n];
      }
      seen.size = left;
    }
  }

  Eigen::Vector2f focal_, centre_;
  const std::vector<PlacedRays>& rays_;
  std::vector<RigidTransform> to_rays_;
};

/// Pixels with an edge of a tile between them and one beside them, and what they have.
std::vector<Contest> find_edges(const Columns& columns, const std::vector<Tile>& tiles,
                                const std::vector<float>& nearness) {
  std::vector<Contest> found;
  for (const Tile& tile : tiles)
    for (int v = tile.begin_v; v < tile.end_v; ++v) {
      const std::size_t row = columns.at(tile.begin_u, v);
      const Ints edges =
          edges_of_row(&nearness[row], columns.stride, v > tile.begin_v, v + 1 < tile.end_v);
      if (!any(edges)) continue;
      for (int lane = 0; lane < tile.end_u - tile.begin_u; ++lane)
        if (edges[lane]) found.push_back({tile.begin_u + lane, v, {nearness[row + lane]}});
    }
  return found;
}

/// Leaves out what no ray met at edges. Surfaces end at their last returns, what they belong to up
/// to a pixel farther out: beside a nearer surface a pixel is of that if rays met it there, and
/// closer by than what the pixel has.
void move_edges(const Columns& columns, const std::vector<Tile>& tiles, const Questions& questions,
                std::vector<float>& nearness, std::vector<float>& told) {
  const auto at = [&](const Contest& c) { return columns.at(c.u, c.v); };
  const std::vector<Contest> edges = find_edges(columns, tiles, nearness);
  std::vector<Contest> asked;
  for (const Contest& edge : edges)
    if (edge.offers[0] == 0)
      told[at(edge)] = 0;
    else if (std::isinf(told[at(edge)]))
      asked.push_back(edge);
  std::vector<float> balance = questions.ask(asked, 0, kMet);
  for (std::size_t i = 0; i < asked.size(); ++i) told[at(asked[i])] = balance[i];

  asked.clear();
  for (const Contest& edge : edges) {
    const auto [u, v] = std::pair(edge.u, edge.v);
    float nearest = 0;
    const auto look = [&](std::size_t i) {
      if (told[i] >= kLeftOut) nearest = std::max(nearest, nearness[i]);
    };
    if (u % Candidates::kTile > 0) look(columns.at(u - 1, v));
    if (u % Candidates::kTile + 1 < Candidates::kTile) look(columns.at(u + 1, v));
    if (v % Candidates::kTile > 0) look(columns.at(u, v - 1));
    if (v % Candidates::kTile + 1 < Candidates::kTile && v + 1 < columns.height)
      look(columns.at(u, v + 1));
    if (nearest > edge.offers[0] * (1 + kSame) && told[at(edge)] < kSurelyMet)
      asked.push_back({u, v, {nearest}});
  }
  balance = questions.ask(asked, 0, kMet);
  for (std::size_t i = 0; i < asked.size(); ++i)
    if (balance[i] > std::max(kGoesOn, told[at(asked[i])]))
      nearness[at(asked[i])] = asked[i].offers[0], told[at(asked[i])] = balance[i];
  for (std::size_t i = 0; i < told.size(); ++i)
    if (told[i] < kLeftOut) nearness[i] = 0;
}

}  // namespace

Candidates::Candidates(const Columns& columns, std::vector<float> trusted)
    : columns_(columns), tiles_(tiles_along(columns.width)), open_(edge_tiles(columns, trusted)) {
  for (int k = 1; k < kMost; ++k) offers_[k].assign(trusted.size(), 0.0f);
  offers_[0] = std::move(trusted);
}

void Candidates::take(float* nearness) {
  const auto rows = DOCDEPTH_HAS_AVX2() ? take_avx2 : take_plain;
  for (std::size_t tile = 0; tile < open_.size(); ++tile) {
    if (!open_[tile]) continue;
    const int u = int(tile) % tiles_ * kTile, v = int(tile) / tiles_ * kTile;
    const std::size_t at = columns_.at(u, v);
    TakeRows part{nearness + at, {}, columns_.stride, std::min(kTile, columns_.height - v)};
    for (int k = 0; k < kMost; ++k) part.offers[k] = offers_[k].data() + at;
    rows(part);
  }
}

std::vector<float> Candidates::settle(const Camera& camera,
                                      const std::vector<PlacedRays>& rays) const {
  std::vector<float> result = offers_[0];
  if (rays.empty()) return result;
  std::vector<Tile> tiles;
  for (int i = 0; i < int(open_.size()); ++i)
    if (open_[i]) tiles.emplace_back(columns_, i % tiles_, i / tiles_);
  std::vector<Contest> contests;
  for (const Tile& tile : tiles)
    for (int v = tile.begin_v; v < tile.end_v; ++v)
      for (int u = tile.begin_u; u < tile.end_u; ++u) {
        const std::size_t at = columns_.at(u, v);
        if (!(offers_[1][at] > 0)) continue;
        Contest contest{u, v, {}};
        for (int k = 0; k < kMost; ++k) contest.offers[k] = offers_[k][at];
        result[at] = 0;
        std::sort(contest.offers, contest.offers + kMost, std::greater<float>());
        contests.push_back(contest);
      }
  const Questions questions(columns_, camera, rays);
  std::vector<float> told(result.size(), INFINITY);  // of the result, infinite while not asked
  for (int k = 0; k < kMost && !contests.empty(); ++k) {
    const std::vector<float> balance = questions.ask(contests, k);
    std::size_t left = 0;
    for (std::size_t i = 0; i < contests.size(); ++i) {
      const Contest c = contests[i];
      const std::size_t at = columns_.at(c.u, c.v);
      if (balance[i] > 0 || (balance[i] == 0 && result[at] == 0))
        result[at] = c.offers[k], told[at] = balance[i];
      if (!(balance[i] > 0) && k + 1 < kMost && c.offers[k + 1] > 0) contests[left++] = c;
    }
    contests.resize(left);
  }
  if (rays.size() == 1) return result;  // a sweep alone knows no more than it offers
  move_edges(columns_, tiles, questions, result, told);
  return result;
}

void add_mover(const Columns& columns, const Camera& camera, const std::vector<float>& trusted,
               const std::vector<float>& others, const std::vector<PlacedRays>& rays,
               std::vector<float>& nearness) {
  std::vector<Contest> contests;
  for (int v = 0; v < columns.height; ++v)
    for (int u = 0; u < columns.width; ++u) {
      const std::size_t at = columns.at(u, v);
      const bool sure = trusted[at] > 0 || rays.empty();
      const float mover = trusted[at] > 0 ? trusted[at] : others[at];
      if (!(mover > nearness[at])) continue;
      if (sure)
        nearness[at] = mover;
      else
        contests.push_back({u, v, {mover}});
    }
  const auto balance = Questions(columns, camera, rays).ask(contests, 0, kSure, kPassedGuess);
  for (std::size_t i = 0; i < contests.size(); ++i) {
    float& here = nearness[columns.at(contests[i].u, contests[i].v)];
    if (balance[i] > kMet)
      here = contests[i].offers[0];
    else if (balance[i] > -kSure)
      here = 0;
  }
}

}  // namespace docdepth
