// Where a tracked object is over time.
#pragma once

#include <vector>

#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/paths/path_estimation.hpp"
#include "docdepth/tracking/tracker.hpp"

namespace docdepth {

/// The path of a track: where its object is at any time, and around what was seen of it.
class TrackPath {
 public:
  TrackPath(Path path, const TrackingOptions& options);

  /// The object at a time [s], interpolated between its observations and continued beyond them.
  Pose pose(double t) const;  ///< T_world_object; x forward, z up
  Eigen::Vector3d velocity(double t) const;
  float speed(double t) const { return float(velocity(t).norm()); }

  /// Whether the position is known: between observations and a little outside, longer if it stands.
  bool covers(double t) const;
  /// Around what was seen of it near a time.
  OrientedBox box(double t) const;
  /// Around all that was ever seen of it.
  OrientedBox whole_box(double t) const { return around(path_.extent, t); }
  /// Around all places where the path covers it, and more, as seen from above: heights are 0.
  Extent reach() const;
  /// How well its place is known at an observation [m].
  double deviation(std::size_t observation) const { return path_.states[observation].deviation; }
  /// The same of what is seen of its surface, across itself [m]: a lorry may be known badly along
  /// its side, and the side well.
  double surface_deviation(std::size_t observation) const {
    return path_.states[observation].surface_deviation;
  }
  /// How far it surely goes from its first place, level [m]. What is seen of a bush goes up and
  /// down, and a fence shows no shift along it.
  float distance() const;
  /// The same in transient observations only.
  float transient_distance() const;

  bool is_rigid() const { return path_.rigid; }
  /// Whether it is wider than a person while it is transient. In most sweeps a person may be one
  /// object with the parked cars beside him, but these are not transient.
  bool is_wide_while_transient() const { return path_.wide_while_transient; }
  /// Whether ground was seen around it; then its heights are those over the ground.
  bool has_ground() const { return path_.has_ground; }
  /// Around all that was seen of it, in its own frame.
  const Extent& extent() const { return path_.extent; }

 private:
  int after(double t) const;
  int count() const { return int(path_.states.size()); }
  OrientedBox around(const Extent& extent, double t) const;

  Path path_;
  double window_, max_gap_, max_gap_standing_;  ///< of TrackingOptions [s]
};

}  // namespace docdepth
