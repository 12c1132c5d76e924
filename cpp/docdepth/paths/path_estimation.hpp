// Where a tracked object is at each of its observations: its surfaces registered onto each other.
#pragma once

#include <vector>

#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/paths/registration.hpp"
#include "docdepth/tracking/track.hpp"

namespace docdepth {

/// T_world_object of what does not lean sideways.
/// @param heading, slope  of the x axis [rad]
Pose upright_pose(const Eigen::Vector3d& position, double heading, double slope);

/// An object at one of its observations.
struct PathState {
  double time;                         ///< [s]
  Eigen::Vector3d position, velocity;  ///< [m], [m/s]
  double heading, slope;               ///< of its x axis [rad]
  double least_deviation = 0;          ///< of the place, did each sweep err on its own [m]
  double deviation = 0;                ///< of the place, as sweeps in a row err alike [m]
  double surface_deviation = 0;        ///< of the surface, across itself [m]

  /// T_world_object; x forward, z up.
  Pose pose() const { return upright_pose(position, heading, slope); }
};

struct PathEstimate {
  std::vector<PathState> states;  ///< at each observation
  std::vector<Extent> extents;    ///< of what each of them saw, in the frame of the object
  Extent extent{Eigen::Vector3f::Zero(), Eigen::Vector3f::Zero()};  ///< of all that was seen
  bool rigid = false;
  bool passes_wide = true;         ///< wider than a person while it passes, as far as is known
  bool has_ground = false;         ///< heights are those over the ground
  std::size_t begin = 0, end = 0;  ///< the observations that are one object

  bool is_one_object() const { return begin == 0 && end == states.size(); }
};

/// Where an object is at each observation of its track.
///
/// Of a vehicle, the surface that each sweep saw is registered onto those of all others, in a frame
/// that moves with it: x along its motion. So it stands still when it stands, however much more of
/// it is seen as the ego comes nearer. A person is not rigid: the shifts from sweep to sweep are
/// summed. Both stand on the ground, where it is seen. Positions are smoothed by how well each is
/// known. Where the track turns out to be several objects, only `begin` and `end` are of use.
///
/// @param seen   what each observation of the track saw
/// @param times  of the sweeps [s]
PathEstimate estimate_path(const Track& track, const SeenSurface* seen,
                           const std::vector<double>& times);

}  // namespace docdepth
