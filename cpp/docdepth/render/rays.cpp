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

/// A plane seen flatter than this says nothing of where the surface goes on [sine].
constexpr float kGrazing = 0.02f;

/// Cells are this many times larger than one of each return would be. It takes both of two rings
/// ten times farther apart than their returns into the cells around a place between them.
constexpr double kCell = 1.6;

bool usable(const Points& points, Eigen::Index i) {
  const float squared = points.row(i).squaredNorm();
  return squared > 0 && squared < 1e12f;  // false for NaN
}

/// The directions of places, the cells they lie in, range and cosine of elevation.
struct Toward {
  float azimuth[Places::kMost], elevation[Places::kMost];
  float range[Places::kMost], narrowed[Places::kMost];
  std::int32_t column[Places::kMost], row[Places::kMost];
};

DOCDEPTH_INLINE void directions_to(const Rays::Cells& cells, const Places& places, Toward& toward) {
  const std::int32_t low = cells.low, side = cells.side, columns = cells.columns;
  for (std::size_t i = 0; i < places.size; ++i) {
    const float x = places.x[i], y = places.y[i], z = places.z[i];
    const Direction direction = direction_of(x, y, z);
    toward.azimuth[i] = float(direction.azimuth);
    toward.elevation[i] = float(direction.elevation);
    const float range = std::sqrt((x * x + y * y) + z * z);
    toward.range[i] = range;
    toward.narrowed[i] = std::sqrt(x * x + y * y) / range;
    // Angles times columns need more than 32 bits, their sixteenths do not.
    const std::int32_t turned = direction.azimuth + kTurn / 2;
    toward.column[i] = ((turned >> 4) * columns + (((turned & 15) * columns) >> 4)) / (kTurn >> 4);
    // Quotients of such small numbers are never rounded to the next one.
    const std::int32_t above = direction.elevation - low + side;
    toward.row[i] = above < 0 ? -9 : std::int32_t(float(above) / float(side)) - 1;
  }
}

/// The least squared angle in units of kTurn to a return, infinite without any, and which.
struct Nearest {
  float squared[Places::kMost];
  std::int32_t number[Places::kMost];
};

/// Up to eight places whose directions lie in one cell.
struct Group {
  std::int32_t column, row, size;
  std::uint8_t places[kLanes];
};

/// Brings places together that lie in one cell, as far as a glance at the latest groups tells.
class Groups {
 public:
  DOCDEPTH_INLINE Groups(const Toward& toward, std::size_t places) {
    static_assert(Places::kMost <= 256, "places are numbered by bytes");
    std::uint8_t latest[kSlots] = {};
    groups_[0] = {-1, -1, kLanes, {}};
    for (std::size_t i = 0; i < places; ++i) {
      const std::int32_t column = toward.column[i], row = toward.row[i];
      std::uint8_t& at = latest[std::uint32_t(5 * column + row) % kSlots];
      const Group& known = groups_[at];
      if (known.column != column || known.row != row || known.size == kLanes) {
        groups_[size_] = {column, row, 0, {}};
        at = static_cast<std::uint8_t>(size_++);
      }
      groups_[at].places[groups_[at].size++] = static_cast<std::uint8_t>(i);
    }
  }
  const Group* begin() const { return groups_; }
  const Group* end() const { return groups_ + size_; }

 private:
  static constexpr int kSlots = 64;
  Group groups_[Places::kMost];
  int size_ = 0;
};

/// The lines of sight that pass nearest to the places of a group, of those in the nine cells around
/// it; of equals the first. One that begins beside the origin seems to, the more so the nearer.
DOCDEPTH_INLINE void find_nearest(const Rays::Cells& cells, const Toward& toward,
                                  const Group& group, Nearest& nearest) {
  float to[4][kLanes];
  for (int lane = 0; lane < kLanes; ++lane) {  // unused ones repeat the last
    const std::size_t i = group.places[std::min(lane, group.size - 1)];
    to[0][lane] = toward.azimuth[i], to[1][lane] = toward.elevation[i];
    to[2][lane] = toward.narrowed[i], to[3][lane] = 1.0f / toward.range[i];
  }
  const Floats azimuth = load(to[0]), elevation = load(to[1]);
  const Floats narrowed = load(to[2]), nearness = load(to[3]);
  Floats least = Floats{} + INFINITY;
  Ints found{};
  const int low = std::max(group.row - 1, 0);
  const int high = std::min(group.row + 1, cells.rows - 1);
  const int left = group.column - 1;
  // As they lie in memory, those that are met around the turn before or after the others.
  const int turn = left + 2 == cells.columns ? 2 : left < 0 ? 1 : 0;
  for (int k = turn; low <= high && k < turn + 3; ++k) {
    const int column = left + k % 3;
    const int turns = column < 0 ? -1 : column == cells.columns ? 1 : 0;
    const std::uint32_t* start =
        &cells.start[std::size_t(column - turns * cells.columns) * cells.rows];
    const Floats from = azimuth - float(turns * kTurn);
    for (std::uint32_t i = start[low]; i < start[high + 1]; ++i) {
      const Floats u = (cells.azimuth[i] - from) * narrowed + cells.left[i] * nearness;
      const Floats v = (cells.elevation[i] - elevation) + cells.up[i] * nearness;
      const Floats squared = u * u + v * v;
      found = squared < least ? Ints{} + std::int32_t(i) : found;
      least = squared < least ? squared : least;
    }
  }
  for (int lane = 0; lane < group.size; ++lane) {
    nearest.squared[group.places[lane]] = least[lane];
    nearest.number[group.places[lane]] = found[lane];
    __builtin_prefetch(&cells.ends[found[lane]]);
  }
}

/// What the nearest rays tell of places, so many metres beside them.
DOCDEPTH_INLINE void add_told(const Rays::Cells& cells, const Places& places, const Toward& toward,
                              const Nearest& nearest, float blur, float* balance) {
  for (std::size_t first = 0; first < places.size; first += kLanes) {
    const std::size_t some = std::min(places.size - first, std::size_t{kLanes});
    float end[4][kLanes];
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const Rays::End& met = cells.ends[nearest.number[first + std::min(lane, some - 1)]];
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
    const Floats weight = 1.0f / ((miss + blur) * (miss + blur));
    const Ints known = (range > 0.0f) & (squared < INFINITY);
    Floats told = passed ? -weight : Floats{};
    told = met ? weight : told;
    for (std::size_t lane = 0; lane < some; ++lane)
      if (known[lane]) balance[first + lane] += told[lane];
  }
}

DOCDEPTH_INLINE void ask_all(const Rays::Cells& cells, const Places& places, float blur,
                             float* balance) {
  Toward toward;
  directions_to(cells, places, toward);
  Nearest nearest;
  for (const Group& group : Groups(toward, places.size))
    find_nearest(cells, toward, group, nearest);
  add_told(cells, places, toward, nearest, blur, balance);
}

DOCDEPTH_AVX2 void ask_avx2(const Rays::Cells& cells, const Places& places, float blur,
                            float* balance) {
  ask_all(cells, places, blur, balance);
}
void ask_plain(const Rays::Cells& cells, const Places& places, float blur, float* balance) {
  ask_all(cells, places, blur, balance);
}

}  // namespace

Rays::Rays(const Points& points, const std::vector<Vector>& normals, const Points* starts) {
  using Sights = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;
  const std::vector<Direction> all =
      starts ? directions_of(Sights(points - *starts)) : directions_of(points);
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
  // With four, neighbours are less than half a turn apart.
  cells_.columns = std::max(4, kTurn / cells_.side);
  cells_.rows = (high - cells_.low) / cells_.side + 1;

  const auto cell = [&](const Direction& d) {
    const auto column = std::int64_t(d.azimuth + kTurn / 2) * cells_.columns / kTurn;
    return std::size_t(column) * cells_.rows + (d.elevation - cells_.low) / cells_.side;
  };
  cells_.start.assign(std::size_t(cells_.columns) * cells_.rows + 1, 0);
  for (const auto i : rows) ++cells_.start[cell(all[i]) + 1];
  for (std::size_t c = 1; c < cells_.start.size(); ++c) cells_.start[c] += cells_.start[c - 1];
  cells_.azimuth.resize(rows.size());
  cells_.elevation.resize(rows.size());
  cells_.left.resize(rows.size());
  cells_.up.resize(rows.size());
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
    if (starts) {
      const Vector start = starts->row(i), sight = p - start;
      const float across = std::sqrt(sight.x() * sight.x() + sight.y() * sight.y());
      const float along = start.x() * sight.x() + start.y() * sight.y();
      const float lift = start.z() * across - along * sight.z() / across;
      cells_.left[to] = (start.y() * sight.x() - start.x() * sight.y()) / across / kRadiansPerUnit;
      cells_.up[to] = lift / std::sqrt(across * across + sight.z() * sight.z()) / kRadiansPerUnit;
    }
    cells_.azimuth[to] = float(all[i].azimuth), cells_.elevation[to] = float(all[i].elevation);
    cells_.ends[to] = {known ? Vector(n / offset) : Vector(p / squared), range};
  }
}

void Rays::ask(const Places& places, float blur, float* balance) const {
  if (cells_.ends.empty()) return;
  const auto ask = DOCDEPTH_HAS_AVX2() ? ask_avx2 : ask_plain;
  ask(cells_, places, blur, balance);
}

}  // namespace docdepth
