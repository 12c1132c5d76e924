// Where a track is at any time, and which static points it supports.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/objects/tracking.hpp"

namespace docdepth {

/// What one sweep saw of a track.
struct TrackObservation {
  std::size_t sweep;
  std::vector<std::uint32_t> objects;  ///< indices of its detections
  Extent box;
  std::size_t dynamic_points;  ///< points that the votes call dynamic

  /// Center of the box on the ground plane.
  Eigen::Vector3f center() const {
    const Eigen::Vector3f middle = 0.5f * (box.low + box.high);
    return {middle.x(), middle.y(), 0};
  }
};

/// Whether a box may be the same object as one that was seen with another size.
bool could_match(const Extent& box, const Eigen::Vector3f& size);

/// The motion of a track, interpolated between its observations.
class TrackMotion {
 public:
  /// @param observations  ordered by time, ascending or descending
  /// @param times         of all sweeps [s]; these and the parameters must outlive the motion
  TrackMotion(std::vector<TrackObservation> observations, const std::vector<double>& times,
              const TrackParameters& p);

  /// Whether enough dynamic points were seen to call the static points of an object dynamic.
  bool can_support(const Detection& object) const {
    return object.points - object.dynamic <= max_static_points_;
  }
  /// Whether the position is known: between observations and a little outside, longer if it stands.
  bool covers(double t) const;
  float speed(double t) const { return velocity(t).norm(); }
  /// Union of the boxes near in time, moved along; that of the nearest if they do not match.
  Extent box(double t) const;
  /// Whether a detection of a sweep belongs to the track.
  bool contains(std::size_t sweep, std::uint32_t object) const;
  /// Whether a place was free while the object was elsewhere, in the sweeps nearest in time.
  bool was_free(const SampledPoints& samples, std::size_t sweep,
                const std::vector<const Detections*>& detections) const;

 private:
  double time(std::size_t k) const { return times_[observations_[k].sweep]; }
  Eigen::Vector3f velocity(double t) const;

  std::vector<TrackObservation> observations_;
  std::vector<Extent> boxes_;  ///< of each observation, as complete as known
  std::size_t max_static_points_ = 0;
  const std::vector<double>& times_;
  const TrackParameters& p_;
};

}  // namespace docdepth
