#include "docdepth/render/rays.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

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

constexpr int kLanes = 8;
typedef float Floats __attribute__((vector_size(4 * kLanes)));
typedef std::int32_t Integers __attribute__((vector_size(4 * kLanes)));

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

/// The least squared angle in units of kTurn to a return, and which; of equals the first.
struct Nearest {
  float squared = INFINITY;
  std::uint32_t number = 0;
};

/// Looks at the returns [begin, end), eight at a time.
DOCDEPTH_INLINE void look(const Rays::Cells& cells, std::uint32_t begin, std::uint32_t end,
                          std::int32_t azimuth, std::int32_t elevation, float narrowed,
                          Floats& least, Integers& found) {
  const Integers lanes = {0, 1, 2, 3, 4, 5, 6, 7};
  for (std::uint32_t i = begin; i < end; i += kLanes) {
    Integers direction;
    std::memcpy(&direction, &cells.directions[i], sizeof direction);
    const Integers number = lanes + std::int32_t(i);
    const Integers across = ((direction - azimuth) << 16) >> 16;
    const Integers along = (direction >> 16) - elevation;
    const Floats u = __builtin_convertvector(across, Floats) * narrowed;
    const Floats v = __builtin_convertvector(along, Floats);
    const Floats squared = u * u + v * v;
    const Integers nearer = (squared < least) & (number < std::int32_t(end));
    least = nearer ? squared : least;
    found = nearer ? number : found;
  }
}

DOCDEPTH_INLINE Nearest nearest(const Rays::Cells& cells, std::int32_t azimuth,
                                std::int32_t elevation, float narrowed) {
  // One more and one less, so that the division never rounds up.
  const int row = (elevation - cells.low + cells.side) / cells.side - 1;
  const int first = std::max(row - 1, 0), last = std::min(row + 1, cells.rows - 1);
  if (elevation - cells.low + cells.side < 0 || first > last) return {};
  const int column = int(std::int64_t(azimuth + kTurn / 2) * cells.columns / kTurn);
  Floats least = Floats{} + INFINITY;
  Integers found{};
  for (int k = -1; k <= 1; ++k) {
    const int c = column + k < 0 ? cells.columns - 1 : column + k == cells.columns ? 0 : column + k;
    const std::uint32_t* start = &cells.start[std::size_t(c) * cells.rows];
    look(cells, start[first], start[last + 1], azimuth, elevation, narrowed, least, found);
  }
  // The best of eight, four, two.
  const auto fold = [&](const Floats& other, const Integers& number) {
    const Integers better = (other < least) | ((other == least) & (number < found));
    least = better ? other : least;
    found = better ? number : found;
  };
  fold(__builtin_shufflevector(least, least, 4, 5, 6, 7, 0, 1, 2, 3),
       __builtin_shufflevector(found, found, 4, 5, 6, 7, 0, 1, 2, 3));
  fold(__builtin_shufflevector(least, least, 2, 3, 0, 1, 6, 7, 4, 5),
       __builtin_shufflevector(found, found, 2, 3, 0, 1, 6, 7, 4, 5));
  fold(__builtin_shufflevector(least, least, 1, 0, 3, 2, 5, 4, 7, 6),
       __builtin_shufflevector(found, found, 1, 0, 3, 2, 5, 4, 7, 6));
  return {least[0], std::uint32_t(found[0])};
}

/// What a ray tells of a place, `miss` metres beside it.
DOCDEPTH_INLINE float told(const Rays::End& end, const Vector& place, float range, float miss) {
  const float margin = kMargin + kMarginGrowth * range;
  // The surface at the end of the ray, seen in the direction of the place, is at range / before.
  const float before =
      (end.plane.x() * place.x() + end.plane.y() * place.y()) + end.plane.z() * place.z();
  const bool met =
      std::fabs(end.range - range) < margin || range * std::fabs(1 - before) < margin * before;
  const bool passed = end.range > range + margin && before < 1;
  const float weight = 1 / ((miss + kBlur) * (miss + kBlur));
  return met ? weight : passed ? -weight : 0.0f;
}

DOCDEPTH_INLINE void ask_all(const Rays::Cells& cells, const Places& places, float* balance) {
  Toward toward;
  directions_to(places, toward);
  for (std::size_t i = 0; i < places.size; ++i) {
    const float range = toward.range[i];
    if (!(range > 0)) continue;
    const auto [squared, number] =
        nearest(cells, toward.azimuth[i], toward.elevation[i], toward.narrowed[i]);
    if (squared == INFINITY) continue;
    const float miss = (std::sqrt(squared) * kRadiansPerUnit) * range;
    balance[i] += told(cells.ends[number], {places.x[i], places.y[i], places.z[i]}, range, miss);
  }
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
  cells_.directions.resize(rows.size() + kLanes);  // some are read behind the last
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
