// An object as a few evenly spread points, and the shift between two observations of it.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Edge of a voxel [m], half of kMatchDistance.
constexpr float kSampleSpacing = 0.15f;
/// Larger objects get voxels this many times larger until their samples are few enough.
constexpr float kSampleSpacingGrowth = 1.3f;

/// Two samples tell a shift if they were measured at least this share of the time between their
/// sweeps apart: over less, their distance is noise more than motion.
constexpr float kMinTimeShare = 0.3f;
/// A sample is matched by another one within this distance [m].
constexpr float kMatchDistance = 0.3f;

using SampledPoints = std::vector<Eigen::Vector3f>;
class PointGrid;

/// An axis-aligned box by its corners.
struct Extent {
  Eigen::Vector3f low, high;

  Eigen::Vector3f size() const { return high - low; }
  float width() const { return size().head<2>().norm(); }  ///< horizontal diagonal
  void add(const Extent& other) {
    low = low.cwiseMin(other.low);
    high = high.cwiseMax(other.high);
  }
  Extent moved(const Eigen::Vector3f& shift) const { return {low + shift, high + shift}; }
  /// What of it lies within another one; flat on its border if nothing does.
  Extent clipped(const Extent& other) const {
    return {low.cwiseMax(other.low).cwiseMin(other.high),
            high.cwiseMin(other.high).cwiseMax(other.low)};
  }
  bool overlaps(const Extent& other, float margin) const {
    return ((low.array() <= other.high.array() + margin) &&
            (other.low.array() <= high.array() + margin))
        .all();
  }
};

/// A box that is turned as an object is.
struct OrientedBox {
  Eigen::Isometry3f T_box_world;  ///< x forward, z up; the origin is the middle of the box
  Eigen::Vector3f half;           ///< half of its length, width and height [m]

  /// Whether a point lies in the box or at most `margin` beside it [m].
  bool contains(const Eigen::Vector3f& point, float margin) const {
    const Eigen::Vector3f p = T_box_world * point;
    return (p.array().abs() <= half.array() + margin).all();
  }
  Eigen::Vector3f middle() const { return T_box_world.inverse().translation(); }
  /// Around all that lies in the box or at most `margin` beside it [m].
  Extent extent(float margin) const {
    const Eigen::Isometry3f T = T_box_world.inverse();
    const Eigen::Vector3f larger = half.array() + margin;
    const Eigen::Vector3f reach = T.linear().cwiseAbs() * larger;
    return {T.translation() - reach, T.translation() + reach};
  }
};

/// Bounding box of at least one point.
Extent extent_of(const SampledPoints& points);

/// Index of the voxel of edge `size` that holds a coordinate.
std::int64_t voxel_coordinate(float value, float size);
/// One key of three voxel indices.
std::uint64_t voxel_key(std::int64_t x, std::int64_t y, std::int64_t z);
/// Key of the voxel of edge `size` that holds a point.
std::uint64_t voxel_key(const Eigen::Vector3f& point, float size);

/// Mean of the points in each voxel of edge `size`, in the order of the first point of each.
SampledPoints downsample(const SampledPoints& points, float size);

/// The same with voxels that grow, up to the edge `largest`, until there are at most `most` means.
SampledPoints downsample(const SampledPoints& points, float size, std::size_t most,
                         float largest = std::numeric_limits<float>::infinity());

/// Points of a surface with its normals, of any length; zero where the normal is unknown.
struct SampledSurface {
  SampledPoints points, normals;
};

/// Points of a sweep and when each was measured [s].
struct TimedPoints {
  SampledPoints points;
  std::vector<float> times;

  void add(const Eigen::Vector3f& point, float time) {
    points.push_back(point);
    times.push_back(time);
  }
};

/// Means of points and of their times.
TimedPoints downsample(const TimedPoints& points, float size, std::size_t most);

/// A surface and when each of its points was measured [s].
struct TimedSurface : SampledSurface {
  std::vector<float> times;

  void add(const Eigen::Vector3f& point, const Eigen::Vector3f& normal, float time) {
    points.push_back(point);
    normals.push_back(normal);
    times.push_back(time);
  }
};

/// Means of points and of their times, and sums of normals.
TimedSurface downsample(const TimedSurface& surface, float size);

/// Mean of the finite points, and of their times, in each voxel of edge `size`, in the order of the
/// first point of each. Points nearer than `min_range` or not nearer than `max_range` are left out.
/// Within a voxel motion is linear in time: the mean of deskewed points is the deskewed mean.
TimedPoints downsample_sweep(const Points& points, const float* times, float size, float min_range,
                             float max_range);

/// Where points that go with a velocity are at one time [s].
SampledPoints at_time(const SampledPoints& points, const std::vector<float>& times,
                      const Eigen::Vector3f& velocity, float time);

/// How far an object goes from one sweep to another, `dt` later, by the motion that explains most
/// of the differences b - a: the horizontal shift up to `reach`, after a vertical one by `rise`.
///
/// @param a, b  with times after the stamps of the sweeps [s]
Eigen::Vector3f most_frequent_shift(const TimedPoints& a, const TimedPoints& b, float dt,
                                    float reach, float rise);

/// Refine a shift so that points of a and b that are each other's nearest coincide (horizontal
/// ICP).
/// @return false if no two points are near
bool refine_shift(const SampledPoints& a, const SampledPoints& b, Eigen::Vector3f& shift);

/// Share of the shifted points that have one of `others` within `distance`.
float matched_share(const SampledPoints& points, const Eigen::Vector3f& shift,
                    const PointGrid& others, float distance = kMatchDistance);
float matched_share(const SampledPoints& points, const Eigen::Vector3f& shift,
                    const SampledPoints& others, float distance = kMatchDistance);

}  // namespace docdepth
