// The end at which a track goes on: what was seen of the object last, and how it moves.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>

#include "docdepth/detections/constants.hpp"
#include "docdepth/detections/detections.hpp"
#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/tracking/elevation.hpp"

namespace docdepth {

/// How wrong a shift of what is so far away may be [m].
inline float shift_error_at(float range) {
  return std::max(kShiftError, kRaySpacing * range);
}

/// Velocity at an end of a track: the mean of its shifts, the last ones most.
struct Speed {
  Eigen::Vector3f velocity = Eigen::Vector3f::Zero();
  float error = 0;  ///< of it [m/s]
  bool is_known = false;

  /// @param shift_error  how wrong the shift may be [m]
  void add(const Eigen::Vector3f& shift, double dt, float shift_error) {
    const auto t = static_cast<float>(dt);
    const Eigen::Vector3f measured = shift / t;
    const float its_error = shift_error / std::fabs(t);
    velocity = is_known ? Eigen::Vector3f(0.5f * velocity + 0.5f * measured) : measured;
    error = is_known ? 0.5f * error + 0.5f * its_error : its_error;
    is_known = true;
  }
  /// Whether it can go so far within a duration [s]: no road user changes its speed faster.
  bool allows(const Eigen::Vector3f& shift, double dt, float shift_error) const {
    if (!is_known) return true;
    const auto t = static_cast<float>(std::fabs(dt));
    const float most = kMaxAcceleration * t * t / 2 + error * t + shift_error;
    return (shift - velocity * float(dt)).head<2>().norm() <= most;
  }
};

inline void append(SampledPoints& samples, const SampledPoints& more) {
  samples.insert(samples.end(), more.begin(), more.end());
}

inline void append(TimedPoints& samples, const Detection& object) {
  append(samples.points, object.samples());
  const auto& times = object.surface.times;
  samples.times.insert(samples.times.end(), times.begin(), times.end());
}

/// The end at which a track goes on.
struct TrackEnd {
  int track;
  std::size_t sweep;                       ///< of the last observation
  std::shared_ptr<const Detections> seen;  ///< by that sweep
  TimedPoints samples;      ///< of the last two observations: each may see another part
  TimedPoints last;         ///< of the last observation; times after the stamp of its sweep
  Eigen::Vector3f largest;  ///< size of its objects
  double time;              ///< stamp of its sweep [s]
  float offset;             ///< mean time of what was seen last, after the stamp [s]
  Speed speed;
  Elevation elevation;
  float area = 0;                ///< that was seen of it when it was not partly hidden
  SampledPoints neighbors = {};  ///< of what touched it but is none of it, where these stand

  /// Keep the samples of two observations, held at `offset` as fast as the shift between them says,
  /// the older ones moved along.
  void hold(const TimedPoints& older, const TimedPoints& newer, const Eigen::Vector3f& shift,
            double dt) {
    const Eigen::Vector3f velocity = shift / float(dt);
    const auto at_offset = [&](SampledPoints points) {
      std::vector<float> times(points.size(), offset);
      return TimedPoints{std::move(points), std::move(times)};
    };
    SampledPoints both = held(older.points, older.times, velocity, offset);
    for (Eigen::Vector3f& p : both) p += shift;
    last = at_offset(held(newer.points, newer.times, velocity, offset));
    append(both, last.points);
    samples =
        at_offset(downsample(both, kSampleSpacing, kMaxSamples, largest_spacing(extent_of(both))));
  }
};

}  // namespace docdepth
