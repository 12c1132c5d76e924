#include "docdepth/render/rays.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "docdepth/geometry/simd.hpp"
#include "docdepth/mesh/directions.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// Edge of a cell of rays, in mean distances between returns. The search reads the nine cells
/// around a point, which then reach both of two rings ten times farther apart than their returns.
constexpr double kRayCellSize = 1.6;

bool usable(const Points& points, Eigen::Index i) {
  const float squared = points.row(i).squaredNorm();
  return squared > 0 && squared < kMaxRange * kMaxRange;  // false for NaN
}

/// Directions of points, the cells they lie in, their range and cosine of elevation.
struct Toward {
  float azimuth[PointBatch::kMax], elevation[PointBatch::kMax];
  float range[PointBatch::kMax], cosine[PointBatch::kMax];
  std::int32_t column[PointBatch::kMax], row[PointBatch::kMax];
};

DOCDEPTH_KERNEL void directions_to(const Rays::Cells& cells, const PointBatch& points,
                                   Toward& toward) {
  const std::int32_t low = cells.low, side = cells.side, columns = cells.columns;
  for (std::size_t i = 0; i < points.size; ++i) {
    const float far = std::sqrt((points.x[i] * points.x[i] + points.y[i] * points.y[i]) +
                                points.z[i] * points.z[i]);
    const bool ok = far < kMaxRange;  // else, also for NaN, the point counts as the origin
    const float x = ok ? points.x[i] : 0.0f, y = ok ? points.y[i] : 0.0f,
                z = ok ? points.z[i] : 0.0f, range = ok ? far : 0.0f;
    const Direction direction = direction_of(x, y, z);
    toward.azimuth[i] = float(direction.azimuth);
    toward.elevation[i] = float(direction.elevation);
    toward.range[i] = range;
    toward.cosine[i] = std::sqrt(x * x + y * y) / range;
    // Angles times columns need more than 32 bits, their sixteenths do not.
    const std::int32_t turned = direction.azimuth + kTurn / 2;
    toward.column[i] = ((turned >> 4) * columns + (((turned & 15) * columns) >> 4)) / (kTurn >> 4);
    // Quotients of integers this small are never rounded up to the next integer.
    const std::int32_t above = direction.elevation - low + side;
    toward.row[i] = above < 0 ? -9 : std::int32_t(float(above) / float(side)) - 1;
  }
}

/// The ray nearest to each point: squared angle in units of kTurn, infinite if there is none.
struct Nearest {
  float squared[PointBatch::kMax];
  std::int32_t number[PointBatch::kMax];
};

/// Up to eight points whose directions lie in one cell.
struct Group {
  std::int32_t column, row, size;
  std::uint8_t points[kLanes];
};

/// Groups points that lie in one cell. Only the latest groups are searched, so a cell may have
/// several groups.
class Groups {
 public:
  DOCDEPTH_KERNEL Groups(const Toward& toward, std::size_t points) {
    static_assert(PointBatch::kMax <= 256, "points are numbered by bytes");
    std::uint8_t latest[kSlots] = {};
    groups_[0] = {-1, -1, kLanes, {}};
    for (std::size_t i = 0; i < points; ++i) {
      const std::int32_t column = toward.column[i], row = toward.row[i];
      std::uint8_t& at = latest[std::uint32_t(5 * column + row) % kSlots];
      const Group& known = groups_[at];
      if (known.column != column || known.row != row || known.size == kLanes) {
        groups_[size_] = {column, row, 0, {}};
        at = static_cast<std::uint8_t>(size_++);
      }
      groups_[at].points[groups_[at].size++] = static_cast<std::uint8_t>(i);
    }
  }
  const Group* begin() const { return groups_; }
  const Group* end() const { return groups_ + size_; }

 private:
  static constexpr int kSlots = 64;
  Group groups_[PointBatch::kMax];
  int size_ = 0;
};

/// The rays nearest to the points of a group, of those in the nine cells around it; of equals the
/// first. The offset of a ray's origin shifts its apparent direction by offset / range.
DOCDEPTH_KERNEL void find_nearest(const Rays::Cells& cells, const Toward& toward,
                                  const Group& group, Nearest& nearest) {
  float to[4][kLanes];
  for (int lane = 0; lane < kLanes; ++lane) {  // unused lanes repeat the last point
    const std::size_t i = group.points[std::min(lane, group.size - 1)];
    to[0][lane] = toward.azimuth[i];
    to[1][lane] = toward.elevation[i];
    to[2][lane] = toward.cosine[i];
    to[3][lane] = 1.0f / toward.range[i];
  }
  const Floats azimuth = load(to[0]), elevation = load(to[1]);
  const Floats cosine = load(to[2]), inverse_range = load(to[3]);
  Floats least = Floats{} + INFINITY;
  Ints found{};
  const int low = std::max(group.row - 1, 0);
  const int high = std::min(group.row + 1, cells.rows - 1);
  const int left = group.column - 1;
  // In the order of memory: columns beyond the seam come before or after the others.
  const int turn = left + 2 == cells.columns ? 2 : left < 0 ? 1 : 0;
  for (int k = turn; low <= high && k < turn + 3; ++k) {
    const int column = left + k % 3;
    const int turns = column < 0 ? -1 : column == cells.columns ? 1 : 0;
    const int place = cells.place(column - turns * cells.columns);
    if (place == cells.used) continue;
    const std::uint32_t* start = &cells.start[std::size_t(place) * cells.rows];
    const Floats from = azimuth - float(turns * kTurn);
    for (std::uint32_t i = start[low]; i < start[high + 1]; ++i) {
      const Floats u = (cells.azimuth[i] - from) * cosine + cells.left[i] * inverse_range;
      const Floats v = (cells.elevation[i] - elevation) + cells.up[i] * inverse_range;
      const Floats squared = u * u + v * v;
      found = squared < least ? Ints{} + std::int32_t(i) : found;
      least = squared < least ? squared : least;
    }
  }
  for (int lane = 0; lane < group.size; ++lane) {
    nearest.squared[group.points[lane]] = least[lane];
    nearest.number[group.points[lane]] = found[lane];
    __builtin_prefetch(&cells.ends[found[lane]]);
  }
}

/// Add the scores of the nearest rays.
DOCDEPTH_KERNEL void add_scores(const Rays::Cells& cells, const PointBatch& points,
                                const Toward& toward, const Nearest& nearest, float blur,
                                float* scores) {
  for (std::size_t first = 0; first < points.size; first += kLanes) {
    const std::size_t some = std::min(points.size - first, std::size_t{kLanes});
    float end[4][kLanes];
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const Rays::End& ray_end = cells.ends[nearest.number[first + std::min(lane, some - 1)]];
      end[0][lane] = ray_end.plane.x();
      end[1][lane] = ray_end.plane.y();
      end[2][lane] = ray_end.plane.z();
      end[3][lane] = ray_end.range;
    }
    const Floats range = load(toward.range + first), squared = load(nearest.squared + first);
    const Floats miss = (root(squared) * kRadiansPerUnit) * range;
    const Floats margin = kSurfaceMargin + kSurfaceMarginGrowth * range, ray = load(end[3]);
    // In the direction of the point, the plane at the end of the ray has the range range / depth.
    const Floats depth =
        (load(end[0]) * load(points.x + first) + load(end[1]) * load(points.y + first)) +
        load(end[2]) * load(points.z + first);
    const Ints ended =
        (absolute(ray - range) < margin) | (range * absolute(1.0f - depth) < margin * depth);
    const Ints passed = (ray > range + margin) & (depth < 1.0f);
    const Floats weight = 1.0f / ((miss + blur) * (miss + blur));
    const Ints known = (range > 0.0f) & (squared < INFINITY);
    Floats score = passed ? -weight : Floats{};
    score = ended ? weight : score;
    for (std::size_t lane = 0; lane < some; ++lane)
      if (known[lane]) scores[first + lane] += score[lane];
  }
}

struct ScoreVisibility {
  DOCDEPTH_KERNEL static void run(const Rays::Cells& cells, const PointBatch& points, float blur,
                                  float* scores) {
    Toward toward;
    directions_to(cells, points, toward);
    Nearest nearest;
    for (const Group& group : Groups(toward, points.size))
      find_nearest(cells, toward, group, nearest);
    add_scores(cells, points, toward, nearest, blur, scores);
  }
};

/// A ray before it is sorted into its cell.
struct UnsortedRay {
  float left, up;  ///< offset of its origin from the sensor [units * m]
  float plane[3];  ///< of the surface at its end
  float range;
};

struct PrepareRays {
  /// @param origins  where each ray starts; null for the sensor
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* points, std::size_t stride,
                                  const Vector* normals, const float* origins,
                                  std::size_t origin_stride, UnsortedRay* __restrict rays) {
    for (std::size_t i = 0; i < count; ++i) {
      const float* p = points + stride * i;
      const float x = p[0], y = p[1], z = p[2];
      const float n_x = normals[i].x(), n_y = normals[i].y(), n_z = normals[i].z();
      const float squared = (x * x + y * y) + z * z;
      const float length = std::sqrt((n_x * n_x + n_y * n_y) + n_z * n_z);
      const float offset = (n_x * x + n_y * y) + n_z * z;
      const float range = std::sqrt(squared);
      const bool known = std::fabs(offset) > kMinIncidenceSine * length * range;
      const float over = known ? offset : squared;
      rays[i].plane[0] = (known ? n_x : x) / over;
      rays[i].plane[1] = (known ? n_y : y) / over;
      rays[i].plane[2] = (known ? n_z : z) / over;
      rays[i].range = range;
    }
    for (std::size_t i = 0; origins && i < count; ++i) {
      const float *p = points + stride * i, *o = origins + origin_stride * i;
      const float x = p[0] - o[0], y = p[1] - o[1], z = p[2] - o[2];
      const float across = std::sqrt(x * x + y * y), along = o[0] * x + o[1] * y;
      const float lift = o[2] * across - along * z / across;
      rays[i].left = (o[1] * x - o[0] * y) / across / kRadiansPerUnit;
      rays[i].up = lift / std::sqrt(across * across + z * z) / kRadiansPerUnit;
    }
  }
};

}  // namespace

Rays::Rays(const Points& points, const std::vector<Vector>& normals, const Points* ray_origins,
           const Sector& sector, const float* time_offset, const std::uint8_t* moving) {
  using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;
  const std::vector<Direction> directions =
      ray_origins ? directions_of(Matrix(points - *ray_origins)) : directions_of(points);
  std::vector<std::uint32_t> rows;
  rows.reserve(points.rows());
  int low = kTurn, high = -kTurn;
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    if (!usable(points, i)) continue;
    low = std::min(low, directions[i].elevation);
    high = std::max(high, directions[i].elevation);
    rows.push_back(static_cast<std::uint32_t>(i));
  }
  if (rows.empty()) return;
  make_cells(rows, low, high, sector);
  const auto cell = [&](const Direction& d) {
    const auto column = std::int64_t(d.azimuth + kTurn / 2) * cells_.columns / kTurn;
    const int place = std::min(cells_.place(int(column)), cells_.used - 1);
    return std::uint32_t(place * cells_.rows + (d.elevation - cells_.low) / cells_.side);
  };
  std::vector<UnsortedRay> rays(points.rows(), UnsortedRay{});
  dispatch<PrepareRays>(rays.size(), points.data(), static_cast<std::size_t>(points.outerStride()),
                        normals.data(), ray_origins ? ray_origins->data() : nullptr,
                        static_cast<std::size_t>(ray_origins ? ray_origins->outerStride() : 0),
                        rays.data());
  std::vector<std::uint32_t> cell_of(rows.size());
  for (std::size_t k = 0; k < rows.size(); ++k) {
    cell_of[k] = cell(directions[rows[k]]);
    ++cells_.start[cell_of[k] + 1];
  }
  for (std::size_t c = 1; c < cells_.start.size(); ++c) cells_.start[c] += cells_.start[c - 1];
  auto next = cells_.start;
  std::vector<std::uint32_t> order(rows.size());
  for (std::size_t k = 0; k < rows.size(); ++k) order[next[cell_of[k]]++] = rows[k];
  // Reading from all over costs less than writing all over.
  for (std::size_t to = 0; to < order.size(); ++to) {
    const std::uint32_t i = order[to];
    const UnsortedRay& ray = rays[i];
    cells_.left[to] = ray.left;
    cells_.up[to] = ray.up;
    cells_.azimuth[to] = float(directions[i].azimuth);
    cells_.elevation[to] = float(directions[i].elevation);
    cells_.ends[to] = {{ray.plane[0], ray.plane[1], ray.plane[2]}, ray.range};
    cells_.time[to] = time_offset ? time_offset[i] : 0.0f;
    cells_.first_time = std::min(cells_.first_time, cells_.time[to]);
    cells_.last_time = std::max(cells_.last_time, cells_.time[to]);
    cells_.moving[to] = moving && moving[i];
  }
}

/// Cells for these rays, with elevations from `low` to `high`, and memory for the rays.
void Rays::make_cells(const std::vector<std::uint32_t>& rows, int low, int high,
                      const Sector& sector) {
  const double area = double(sector.span) * (high - low + 1);
  cells_.low = low;
  cells_.side = std::max(1, int(kRayCellSize * std::sqrt(area / double(rows.size()))));
  // With four columns neighbours are less than half a turn apart.
  cells_.columns = std::max(4, kTurn / cells_.side);
  cells_.rows = (high - low) / cells_.side + 1;
  const auto column_of = [&](std::int64_t azimuth) { return azimuth * cells_.columns / kTurn; };
  const std::int64_t first = sector.first + kTurn / 2;
  cells_.first = int(column_of(first));
  cells_.used = std::min(cells_.columns, int(column_of(first + sector.span) - cells_.first) + 1);
  cells_.start.assign(std::size_t(cells_.used) * cells_.rows + 1, 0);
  for (auto* column : {&cells_.azimuth, &cells_.elevation, &cells_.left, &cells_.up})
    column->resize(rows.size() + kLanes);
  cells_.ends.resize(rows.size());
  cells_.time.resize(rows.size());
  cells_.moving.resize(rows.size());
}

float Rays::Cells::spacing() const {
  return float(side) / float(kRayCellSize) * kRadiansPerUnit;
}

void Rays::query_visibility(const PointBatch& points, float blur, float* scores) const {
  if (cells_.ends.empty()) return;
  dispatch<ScoreVisibility>(cells_, points, blur, scores);
}

}  // namespace docdepth
