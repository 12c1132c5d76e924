#include "docdepth/geometry/sampled_points.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "docdepth/geometry/key_numbers.hpp"
#include "docdepth/geometry/point_grid.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// Farther voxels share one index: beyond it integers would overflow.
constexpr std::int64_t kMaxVoxel = std::int64_t{1} << 40;
/// Edge of a bin of the histogram of shifts [m].
constexpr float kShiftBin = 0.2f;
/// Larger shifts are not looked for [m]: after a pause of the recording the histogram would fill
/// the memory.
constexpr float kMaxShift = 400.0f;
/// Samples whose heights differ more, after the object rose with the ground, are not the same
/// place [m].
constexpr float kMaxHeightDifference = 0.2f;
/// Search radii of the steps that refine a shift [m], from the error of a bin to kMatchDistance.
constexpr float kRefineRadii[] = {0.6f, 0.4f, 0.3f, 0.3f, 0.3f};

/// The voxel of each point; voxels are numbered as they come.
struct Voxels {
  std::vector<std::uint32_t> number;
  std::vector<float> points;  ///< in each voxel

  Voxels(const SampledPoints& of, float size) : number(of.size()) {
    KeyNumbers number_of(of.size());
    for (std::size_t i = 0; i < of.size(); ++i) number[i] = number_of[voxel_key(of[i], size)];
    points.assign(number_of.size(), 0);
    for (const auto voxel : number) ++points[voxel];
  }

  /// Sum of the values of the points in each voxel.
  template <class Value>
  std::vector<Value> sums(const std::vector<Value>& values, const Value& zero) const {
    std::vector<Value> result(points.size(), zero);
    for (std::size_t i = 0; i < number.size(); ++i) result[number[i]] += values[i];
    return result;
  }

  /// Mean of these values.
  template <class Value>
  std::vector<Value> means(const std::vector<Value>& values, const Value& zero) const {
    std::vector<Value> result = sums(values, zero);
    for (std::size_t k = 0; k < result.size(); ++k) result[k] /= points[k];
    return result;
  }
};

}  // namespace

Extent extent_of(const SampledPoints& points) {
  Extent box{points.front(), points.front()};
  for (const Vector& p : points) box.add({p, p});
  return box;
}

std::uint64_t voxel_key(std::int64_t x, std::int64_t y, std::int64_t z) {
  constexpr std::int64_t middle = 1 << 20, mask = (1 << 21) - 1;
  return std::uint64_t((x + middle) & mask) << 42 | std::uint64_t((y + middle) & mask) << 21 |
         std::uint64_t((z + middle) & mask);
}

std::int64_t voxel_coordinate(float value, float size) {
  const float steps = value / size;  // floor, without the call that old processors need
  if (!(std::fabs(steps) < kMaxVoxel)) return steps > 0 ? kMaxVoxel : -kMaxVoxel;  // also for NaN
  const auto whole = static_cast<std::int64_t>(steps);
  return whole - (static_cast<float>(whole) > steps);
}

std::uint64_t voxel_key(const Vector& point, float size) {
  return voxel_key(voxel_coordinate(point.x(), size), voxel_coordinate(point.y(), size),
                   voxel_coordinate(point.z(), size));
}

SampledPoints downsample(const SampledPoints& points, float size) {
  return Voxels(points, size).means<Vector>(points, Vector::Zero());
}

SampledPoints downsample(const SampledPoints& points, float size, std::size_t most, float largest) {
  SampledPoints samples = downsample(points, size);
  while (samples.size() > most && size < largest) {
    size = std::min(size * kSampleSpacingGrowth, largest);
    samples = downsample(points, size);
  }
  return samples;
}

TimedPoints downsample(const TimedPoints& points, float size, std::size_t most) {
  Voxels voxels(points.points, size);
  while (voxels.points.size() > most) voxels = Voxels(points.points, size *= kSampleSpacingGrowth);
  return {voxels.means<Vector>(points.points, Vector::Zero()), voxels.means(points.times, 0.0f)};
}

TimedSurface downsample(const TimedSurface& surface, float size) {
  const Voxels voxels(surface.points, size);
  TimedSurface result;
  result.points = voxels.means<Vector>(surface.points, Vector::Zero());
  result.times = voxels.means(surface.times, 0.0f);
  result.normals = voxels.sums<Vector>(surface.normals, Vector::Zero());
  return result;
}

TimedPoints downsample_sweep(const Points& points, const float* times, float size, float min_range,
                             float max_range) {
  TimedPoints means;
  std::vector<float> counts;
  KeyNumbers number_of(static_cast<std::size_t>(points.rows()));
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const Vector p = points.row(i).transpose();
    const float squared = p.squaredNorm();
    // Written so that points that are not finite are left out, too.
    if (!(squared > min_range * min_range && squared < max_range * max_range)) continue;
    const std::size_t number = number_of[voxel_key(p, size)];
    if (number == means.points.size()) {
      means.points.push_back(p);
      means.times.push_back(times[i]);
      counts.push_back(1);
    } else {
      means.points[number] += p;
      means.times[number] += times[i];
      ++counts[number];
    }
  }
  for (std::size_t k = 0; k < counts.size(); ++k) {
    means.points[k] /= counts[k];
    means.times[k] /= counts[k];
  }
  return means;
}

SampledPoints at_time(const SampledPoints& points, const std::vector<float>& times,
                      const Vector& velocity, float time) {
  SampledPoints there(points.size());
  for (std::size_t i = 0; i < points.size(); ++i)
    there[i] = points[i] - (times[i] - time) * velocity;
  return there;
}

Vector most_frequent_shift(const TimedPoints& a, const TimedPoints& b, float dt, float reach,
                           float rise) {
  if (!(reach < kMaxShift)) reach = kMaxShift;
  const int side =
      2 * static_cast<int>(std::ceil(reach / kShiftBin)) + 3;  // a border of empty bins
  std::vector<int> counts(side * side, 0);
  for (std::size_t i = 0; i < a.points.size(); ++i)
    for (std::size_t j = 0; j < b.points.size(); ++j) {
      const float share = 1 + (b.times[j] - a.times[i]) / dt;  // of the time between the sweeps
      if (!(share >= kMinTimeShare)) continue;
      Vector d = b.points[j] - a.points[i];
      d.z() -= rise * share;
      d.head<2>() /= share;
      // Written so that differences that are not finite are left out, too.
      if (!(std::fabs(d.z()) <= kMaxHeightDifference && std::fabs(d.x()) <= reach &&
            std::fabs(d.y()) <= reach))
        continue;
      const int u = side / 2 + static_cast<int>(std::lround(d.x() / kShiftBin));
      const int v = side / 2 + static_cast<int>(std::lround(d.y() / kShiftBin));
      ++counts[u * side + v];
    }
  int most = -1, best = 0;
  for (int u = 1; u + 1 < side; ++u)
    for (int v = 1; v + 1 < side; ++v) {
      int sum = 0;
      for (int du = -1; du <= 1; ++du)
        for (int dv = -1; dv <= 1; ++dv) sum += counts[(u + du) * side + v + dv];
      if (sum > most) {
        most = sum;
        best = u * side + v;
      }
    }
  return {float(best / side - side / 2) * kShiftBin, float(best % side - side / 2) * kShiftBin,
          rise};
}

bool refine_shift(const SampledPoints& a, const SampledPoints& b, Vector& shift) {
  if (b.empty()) return false;
  const PointGrid of_b(b);
  SampledPoints moved(a.size());
  for (const float radius : kRefineRadii) {
    for (std::size_t i = 0; i < a.size(); ++i) moved[i] = a[i] + shift;
    const PointGrid of_moved(moved);
    Vector sum = Vector::Zero();
    std::size_t count = 0;
    for (std::size_t i = 0; i < moved.size(); ++i) {
      const auto [squared, partner] = of_b.nearest(moved[i], radius);
      if (squared > radius * radius) continue;
      // What is hidden by now would pull towards the edge of what is not.
      if (of_moved.nearest(b[partner], radius).second != i) continue;
      sum += b[partner] - moved[i];
      ++count;
    }
    if (!count) return false;
    shift += Vector(sum.x() / float(count), sum.y() / float(count), 0);
  }
  return true;
}

float matched_share(const SampledPoints& points, const Vector& shift, const PointGrid& others,
                    float distance) {
  std::size_t found = 0;
  for (const Vector& point : points) {
    const Vector p = point + shift;
    found += others.any_near(p, distance, [&](const Vector& other, std::size_t) {
      return (other - p).squaredNorm() < distance * distance;
    });
  }
  return float(found) / float(points.size());
}

float matched_share(const SampledPoints& points, const Vector& shift, const SampledPoints& others,
                    float distance) {
  return matched_share(points, shift, PointGrid(others), distance);
}

}  // namespace docdepth
