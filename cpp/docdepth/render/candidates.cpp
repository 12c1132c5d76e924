#include "docdepth/render/candidates.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>

#include "docdepth/geometry/rigid.hpp"
#include "docdepth/render/dispatch.hpp"

namespace docdepth {
namespace {

constexpr float kSame = 0.04f;  ///< offers that differ less are of one surface
constexpr float kEdge = 0.05f;  ///< bend of nearness, linear on every plane, as a share of it

constexpr int kLanes = Candidates::kTile;
typedef float Floats __attribute__((vector_size(4 * kLanes)));
typedef std::int32_t Integers __attribute__((vector_size(4 * kLanes)));

DOCDEPTH_INLINE bool any(const Integers& lanes) {
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
  Integers left = w > 0.0f;
  for (int k = 0; k < Candidates::kMost && any(left); ++k) {
    Floats known;
    std::memcpy(&known, offers(k), sizeof known);
    const Integers empty = left & (known == 0.0f);
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

}  // namespace

Candidates::Candidates(const Columns& columns, std::vector<float> trusted)
    : columns_(columns), tiles_((columns.width + kTile - 1) / kTile), trusted_(std::move(trusted)) {
  const int tile_rows = (columns.height + kTile - 1) / kTile;
  open_.resize(std::size_t(tiles_) * tile_rows);
  for (int v = 0; v < tile_rows; ++v)
    for (int u = 0; u < tiles_; ++u) open_[std::size_t(v) * tiles_ + u] = bends(u, v);
  offers_[0] = trusted_;
  for (int k = 1; k < kMost; ++k) offers_[k].assign(trusted_.size(), 0.0f);
}

/// Is there an edge or an empty pixel in a tile?
bool Candidates::bends(int tile_u, int tile_v) const {
  const int last_u = std::min((tile_u + 1) * kTile, columns_.width) - 1;
  const int last_v = std::min((tile_v + 1) * kTile, columns_.height) - 1;
  const auto bent = [](float before, float here, float after) {
    return !(std::fabs((before - here) - (here - after)) <= kEdge * here);
  };
  for (int v = tile_v * kTile; v <= last_v; ++v)
    for (int u = tile_u * kTile; u <= last_u; ++u) {
      const float* at = &trusted_[std::size_t(v) * columns_.stride + u];
      if (!(*at > 0)) return true;
      if (u > tile_u * kTile && u < last_u && bent(at[-1], at[0], at[1])) return true;
      if (v > tile_v * kTile && v < last_v &&
          bent(at[-columns_.stride], at[0], at[columns_.stride]))
        return true;
    }
  return false;
}

void Candidates::take(float* nearness) {
  const auto rows = DOCDEPTH_HAS_AVX2() ? take_avx2 : take_plain;
  for (std::size_t tile = 0; tile < open_.size(); ++tile) {
    if (!open_[tile]) continue;
    const int u = int(tile) % tiles_ * kTile, v = int(tile) / tiles_ * kTile;
    const std::size_t at = std::size_t(v) * columns_.stride + u;
    TakeRows part{nearness + at, {}, columns_.stride, std::min(kTile, columns_.height - v)};
    for (int k = 0; k < kMost; ++k) part.offers[k] = offers_[k].data() + at;
    rows(part);
  }
}

std::vector<float> Candidates::settle(const Camera& camera,
                                      const std::vector<PlacedRays>& rays) const {
  std::vector<float> result = offers_[0];
  std::vector<Contest> contests;
  for (std::size_t tile = 0; tile < open_.size(); ++tile) {
    if (!open_[tile]) continue;
    const int begin_u = int(tile) % tiles_ * kTile, begin_v = int(tile) / tiles_ * kTile;
    for (int v = begin_v; v < std::min(begin_v + kTile, columns_.height); ++v)
      for (int u = begin_u; u < std::min(begin_u + kTile, columns_.width); ++u) {
        const std::size_t at = std::size_t(v) * columns_.stride + u;
        if (!(offers_[1][at] > 0)) continue;
        Contest contest{u, v, {}};
        for (int k = 0; k < kMost; ++k) contest.offers[k] = offers_[k][at];
        std::sort(contest.offers, contest.offers + kMost, std::greater<float>());
        contests.push_back(contest);
      }
  }
  std::vector<RigidTransform> to_rays;
  for (const auto& placed : rays) to_rays.emplace_back(placed.T_camera_rays.inverse());
  const Eigen::Vector2f focal(camera.fx, camera.fy), centre(camera.cx, camera.cy);
  for (int k = 0; k < kMost; ++k) {
    std::size_t left = 0;
    for (std::size_t first = 0; first < contests.size(); first += Places::kMost) {
      const std::size_t count = std::min(contests.size() - first, Places::kMost);
      Eigen::Vector3f places[Places::kMost];
      for (std::size_t i = 0; i < count; ++i) {
        const auto& [u, v, offers] = contests[first + i];
        const float depth = 1 / offers[k];
        places[i] = {(float(columns_.begin + u) - centre.x()) / focal.x() * depth,
                     (float(v) - centre.y()) / focal.y() * depth, depth};
      }
      float balance[Places::kMost] = {};
      for (std::size_t j = 0; j < rays.size(); ++j) {
        Places seen;
        seen.size = count;
        for (std::size_t i = 0; i < count; ++i) {
          const Eigen::Vector3f p = to_rays[j] * places[i];
          seen.x[i] = p.x(), seen.y[i] = p.y(), seen.z[i] = p.z();
        }
        rays[j].rays->ask(seen, balance);
      }
      for (std::size_t i = 0; i < count; ++i) {
        const Contest c = contests[first + i];
        if (balance[i] > 0)
          result[std::size_t(c.v) * columns_.stride + c.u] = c.offers[k];
        else if (k + 1 < kMost && c.offers[k + 1] > 0)
          contests[left++] = c;
      }
    }
    contests.resize(left);
  }
  return result;
}

}  // namespace docdepth
