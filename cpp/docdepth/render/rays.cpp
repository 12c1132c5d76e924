#include "docdepth/render/rays.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "docdepth/geometry/lanes.hpp"
#include "docdepth/render/dispatch.hpp"
#include "docdepth/surface/directions.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

constexpr float kMargin = 0.1f;         ///< places this near to a surface are on it [m]
constexpr float kMarginGrowth = 0.03f;  ///< growth of that with range [m/m]
constexpr float kBlur = 0.02f;          ///< no ray is known better than this [m]

/// A plane seen flatter than this says nothing of where the surface goes on [sine].
constexpr float kGrazing = 0.02f;

/// Cells are this many times larger than one of each return would be. It takes both of two rings
/// ten times farther apart than their returns into the cells around a place between them.
constexpr double kCell = 1.6;

bool usable(const Points& points, Eigen::Index i) {
  const float squared = points.row(i).squaredNorm();
  return squared > 0 && squared < 1e12f;  // false for NaN
}

/// The directions of places, range and cosine of elevation beside them.
struct Toward {
  std::int32_t azimuth[Places::kMost], elevation[Places::kMost];
  float range[Places::kMost], narrowed[Places::kMost];
};

DOCDEPTH_INLINE void directions_to(const Places& places, Toward& toward) {
  for (std::size_t i = 0; i < places.size; ++i) {
    const float x = places.x[i], y = places.y[i], z = places.z[i];
    const Direction direction = direction_of(x, y, z);
    toward.azimuth[i] = direction.azimuth;
    toward.elevation[i] = direction.elevation;
    toward.range[i] = std::sqrt((x * x + y * y) + z * z);
    toward.narrowed[i] = std::sqrt(x * x + y * y) / toward.range[i];
  }
}

/// The least squared angle in units of kTurn to a return, infinite without any, and which.
struct Nearest {
  float squared[Places::kMost];
  std::uint32_t number[Places::kMost];
};

/// Looks at eight returns from `first` on, without those from `end` on.
DOCDEPTH_INLINE void look(const Rays::Cells& cells, std::uint32_t first, std::uint32_t end,
                          std::int32_t azimuth, std::int32_t elevation, float narrowed,
                          Floats& least, Ints& found) {
  Ints direction;
  std::memcpy(&direction, &cells.directions[first], sizeof direction);
  const Ints number = Ints{0, 1, 2, 3, 4, 5, 6, 7} + std::int32_t(first);
  const Ints across = ((direction - azimuth) << 16) >> 16;
  const Ints along = (direction >> 16) - elevation;
  const Floats u = __builtin_convertvector(across, Floats) * narrowed;
  const Floats v = __builtin_convertvector(along, Floats);
  const Floats squared = u * u + v * v;
  const Ints nearer = (squared < least) & (number < std::int32_t(end));
  least = nearer ? squared : least;
  found = nearer ? number : found;
}

/// Of equals the first.
DOCDEPTH_INLINE void find_nearest(const Rays::Cells& cells, std::int32_t azimuth,
                                  std::int32_t elevation, float narrowed, float& squared,
                                  std::uint32_t& which) {
  squared = INFINITY, which = 0;
  // One more and one less, so that the division never rounds up.
  const int row = (elevation - cells.low + cells.side) / cells.side - 1;
  const int first = std::max(row - 1, 0), last = std::min(row + 1, cells.rows - 1);
  if (elevation - cells.low + cells.side < 0 || first > last) return;
  const int column = int(std::int64_t(azimuth + kTurn / 2) * cells.columns / kTurn);
  Floats least = Floats{} + INFINITY;
  Ints found{};
  for (int k = -1; k <= 1; ++k) {
    const int c = column + k < 0 ? cells.columns - 1 : column + k == cells.columns ? 0 : column + k;
    const std::uint32_t* start = &cells.start[std::size_t(c) * cells.rows];
    const std::uint32_t begin = start[first], end = start[last + 1];
    // Mostly that is all, and looking too far costs less than not knowing how far.
    look(cells, begin, end, azimuth, elevation, narrowed, least, found);
    look(cells, begin + kLanes, end, azimuth, elevation, narrowed, least, found);
    for (std::uint32_t i = begin + 2 * kLanes; i < end; i += kLanes)
      look(cells, i, end, azimuth, elevation, narrowed, least, found);
  }
  // The best of eight, four, two.
  const auto fold = [&](const Floats& other, const Ints& number) {
    const Ints better = (other < least) | ((other == least) & (number < found));
    least = better ? other : least;
    found = better ? number : found;
  };
  fold(__builtin_shufflevector(least, least, 4, 5, 6, 7, 0, 1, 2, 3),
       __builtin_shufflevector(found, found, 4, 5, 6, 7, 0, 1, 2, 3));
  fold(__builtin_shufflevector(least, least, 2, 3, 0, 1, 6, 7, 4, 5),
       __builtin_shufflevector(found, found, 2, 3, 0, 1, 6, 7, 4, 5));
  fold(__builtin_shufflevector(least, least, 1, 0, 3, 2, 5, 4, 7, 6),
       __builtin_shufflevector(found, found, 1, 0, 3, 2, 5, 4, 7, 6));
  squared = least[0], which = std::uint32_t(found[0]);
}

/// What the nearest rays tell of places, so many metres beside them.
DOCDEPTH_INLINE void add_told(const Rays::Cells& cells, const Places& places, const Toward& toward,
                              const Nearest& nearest, float* balance) {
  for (std::size_t first = 0; first < places.size; first += kLanes) {
    const std::size_t some = std::min(places.size - first, std::size_t{kLanes});
    float end[4][kLanes] = {};
    for (std::size_t lane = 0; lane < some; ++lane) {
      const Rays::End& met = cells.ends[nearest.number[first + lane]];
      end[0][lane] = met.plane.x(), end[1][lane] = met.plane.y(), end[2][lane] = met.plane.z();
      end[3][lane] = met.range;
    }
    const Floats range = load(toward.range + first), squared = load(nearest.squared + first);
    const Floats miss = (root(squared) * kRadiansPerUnit) * range;
    const Floats margin = kMargin + kMarginGrowth * range, ray = load(end[3]);
    // The surface at the end of the ray, seen in the direction of the place, is at range / before.
    const Floats before =
        (load(end[0]) * load(places.x + first) + load(end[1]) * load(places.y + first)) +
        load(end[2]) * load(places.z + first);
    const Ints met =
        (absolute(ray - range) < margin) | (range * absolute(1.0f - before) < margin * before);
    const Ints passed = (ray > range + margin) & (before < 1.0f);
    const Floats weight = 1.0f / ((miss + kBlur) * (miss + kBlur));
    const Ints known = (range > 0.0f) & (squared < INFINITY);
    Floats told = passed ? -weight : Floats{};
    told = met ? weight : told;
    for (std::size_t lane = 0; lane < some; ++lane)
      if (known[lane]) balance[first + lane] += told[lane];
  }
}

DOCDEPTH_INLINE void ask_all(const Rays::Cells& cells, const Places& places, float* balance) {
  Toward toward;
  directions_to(places, toward);
  Nearest nearest;
  for (std::size_t i = 0; i < places.size; ++i) {
    find_nearest(cells, toward.azimuth[i], toward.elevation[i], toward.narrowed[i],
                 nearest.squared[i], nearest.number[i]);
    __builtin_prefetch(&cells.ends[nearest.number[i]]);
  }
  add_told(cells, places, toward, nearest, balance);
}

DOCDEPTH_AVX2 void ask_avx2(const Rays::Cells& cells, const Places& places, float* balance) {
  ask_all(cells, places, balance);
}
void ask_plain(const Rays::Cells& cells, const Places& places, float* balance) {
  ask_all(cells, places, balance);
}

}  // namespace

Rays::Rays(const Points& points, const std::vector<Vector>& normals) {
  const std::vector<Direction> all = directions_of(points);
  std::vector<std::uint32_t> rows;
  int high = -kTurn;
  cells_.low = kTurn;
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    if (!usable(points, i)) continue;
    cells_.low = std::min(cells_.low, all[i].elevation), high = std::max(high, all[i].elevation);
    rows.push_back(static_cast<std::uint32_t>(i));
  }
  if (rows.empty()) return;
  const double area = double(kTurn) * (high - cells_.low + 1);
  cells_.side = std::max(1, int(kCell * std::sqrt(area / double(rows.size()))));
  cells_.columns = std::max(3, kTurn / cells_.side);
  cells_.rows = (high - cells_.low) / cells_.side + 1;

  const auto cell = [&](const Direction& d) {
    const auto column = std::int64_t(d.azimuth + kTurn / 2) * cells_.columns / kTurn;
    return std::size_t(column) * cells_.rows + (d.elevation - cells_.low) / cells_.side;
  };
  cells_.start.assign(std::size_t(cells_.columns) * cells_.rows + 1, 0);
  for (const auto i : rows) ++cells_.start[cell(all[i]) + 1];
  for (std::size_t c = 1; c < cells_.start.size(); ++c) cells_.start[c] += cells_.start[c - 1];
  cells_.directions.resize(rows.size() + 2 * kLanes);  // some are read behind the last
  cells_.ends.resize(rows.size());
  auto next = cells_.start;
  for (const auto i : rows) {
    const std::uint32_t to = next[cell(all[i])]++;
    const Vector p = points.row(i), &n = normals[i];
    const float squared = (p.x() * p.x() + p.y() * p.y()) + p.z() * p.z();
    const float length = std::sqrt((n.x() * n.x() + n.y() * n.y()) + n.z() * n.z());
    const float offset = (n.x() * p.x() + n.y() * p.y()) + n.z() * p.z();
    const float range = std::sqrt(squared);
    const bool known = std::fabs(offset) > kGrazing * length * range;
    cells_.directions[to] = all[i].elevation * 65536 + (all[i].azimuth & 0xffff);
    cells_.ends[to] = {known ? Vector(n / offset) : Vector(p / squared), range};
  }
}

void Rays::ask(const Places& places, float* balance) const {
  if (cells_.ends.empty()) return;
  const auto ask = DOCDEPTH_HAS_AVX2() ? ask_avx2 : ask_plain;
  ask(cells_, places, balance);
}

}  // namespace docdepth
