// Where a tracked object is at each of its observations: its surfaces aligned with each other.
#pragma once

#include <span>
#include <variant>
#include <vector>

#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/paths/surface_alignment.hpp"
#include "docdepth/tracking/motion_filter.hpp"
#include "docdepth/tracking/track.hpp"

namespace docdepth {

/// T_world_object of what does not lean sideways.
/// @param heading, slope  of the x axis [rad]
Pose upright_pose(const Eigen::Vector3d& position, double heading, double slope);

/// An object at one of its observations.
struct PathState {
  double time = 0;                                     ///< [s]
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< [m]
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();  ///< [m/s]
  double heading = 0, slope = 0;                       ///< of its x axis [rad]
  bool is_transient = false;                           ///< as in TrackObservation
  double independent_deviation = 0;  ///< of the position, if sweeps erred independently [m]
  double deviation = 0;              ///< of the position, as sweeps in a row err alike [m]
  double surface_deviation = 0;      ///< of the surface, across itself [m]

  /// T_world_object; x forward, z up.
  Pose pose() const { return upright_pose(position, heading, slope); }
};

/// Where an object is at each observation of its track.
struct Path {
  std::vector<PathState> states;  ///< at each observation
  std::vector<Extent> extents;    ///< of what each of them saw, in the frame of the object
  Extent extent{Eigen::Vector3f::Zero(), Eigen::Vector3f::Zero()};  ///< of all that was seen
  bool rigid = false;
  bool wide_while_transient = true;  ///< wider than a person then, as far as is known
  bool has_ground = false;           ///< heights are those over the ground
};

/// The track is several objects: these observations are one of them.
struct Cut {
  std::size_t begin, end;
};

struct PathOptions {
  /// Objects of kMinRigidWidth in this share of their observations are rigid.
  double rigid_quantile = 0.75;
  /// How exactly a shift from sweep to sweep tells the position [m].
  double shift_deviation = 0.08;
  /// The same of the height of the lowest point [m],
  double height_deviation = 0.15;
  /// and where no ground was seen around it, but elsewhere on its path [m]: feet and wheels are
  /// often hidden.
  double hidden_deviation = 0.5;
  /// Errors of shifts add up: after n sweeps to the root of n times this [m].
  double shift_drift = 0.03;
  /// How exactly the shifts tell the speed [m/s].
  double shift_speed_deviation = 3;
  /// How much a road user changes its horizontal acceleration in a second [m/s^2]: firm braking
  /// is 4.
  double horizontal_change = 3;
  /// How much it changes its rate of turn in a second [rad/s^2].
  double turn_change = 1;
  /// This share of it remains when it stands: more cannot be told from noise.
  double standing_turn = 0.02;
  /// Before anything is known of it: rate of turn [rad/s].
  double strongest_turn = 0.5;
  /// Above this speed an object's motion tells its heading [m/s]; a person's at half of it.
  double min_heading_speed = 1.5;
  /// How exactly the motion tells the heading of a vehicle [rad]. Of a car seen from behind only,
  /// the surface says little of it: without this it turns further with each sweep.
  double motion_heading_deviation = 0.1;
  /// A vehicle of which more comes into view seems to go so much faster or slower [m/s].
  double creep = 1;
  /// From the middle of a car to its ends [m], which a wrong heading displaces.
  double half_length = 2;
  /// A model has at most so many voxels along the object.
  float model_voxels = 40;
  /// How exactly a guess tells the position [m] and the heading [rad].
  double guess_deviation = 0.3;
  double guess_heading_deviation = 0.05;
  /// Measurements that the motion does not expect count this many times less.
  double outlier_factor = 100;
  /// An alignment fails if a smaller share of the samples finds partners.
  float min_aligned_share = 0.5f;
  /// Where an alignment is farther than this from where the shifts lead, that place is tried, too
  /// [m].
  double max_drift = 1;
  /// After so many observations in a row that lie beside the model a track goes on with something
  /// else.
  int max_misses = 3;
  /// So many sweeps in a row err alike, as they see the same parts from nearly the same side:
  /// together they tell the place no better than one of them.
  double correlated_sweeps = 9;
  /// Part of an object is what so many sweeps saw,
  int min_hits = 3;
  /// but for the outermost samples.
  double extent_quantile = 0.99;
  AlignmentOptions alignment{};
};

/// Where an object is at each observation of its track, or how the track is to be cut.
///
/// Of a vehicle, the surface that each sweep saw is aligned with those of all others, in a frame
/// that moves with it: x along its motion. So it stands still when it stands, however much more of
/// it is seen as the ego comes nearer. A person is not rigid: the shifts from sweep to sweep are
/// summed. Both stand on the ground, where it is seen. Positions are smoothed by how well each is
/// known.
///
/// @param surfaces  what each observation of the track saw
/// @param times     of the sweeps [s]
std::variant<Path, Cut> estimate_path(const Track& track, std::span<const ObservedSurface> surfaces,
                                      const std::vector<double>& times,
                                      const PathOptions& options = {});

}  // namespace docdepth
