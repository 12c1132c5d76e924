// Where a tracked object is over time: its surfaces registered onto each other.
#pragma once

#include <vector>

#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/objects/oriented_box.hpp"
#include "docdepth/objects/parameters.hpp"
#include "docdepth/objects/registration.hpp"
#include "docdepth/objects/smoothing.hpp"
#include "docdepth/objects/track.hpp"

namespace docdepth {

/// The path of a track.
///
/// Of a vehicle, the surface that each sweep saw is registered onto those of all others, in a frame
/// that moves with it: x along its motion. So it stands still when it stands, however much more of
/// it is seen as the ego comes nearer. A person is not rigid: the shifts from sweep to sweep are
/// summed. Both stand on the ground, where it is seen. Positions are smoothed by how well each is
/// known.
class TrackPath {
 public:
  /// The arguments must outlive the path, but for the surfaces.
  /// @param seen  what each observation of the track saw
  TrackPath(const Track& track, const SeenSurface* seen, const std::vector<double>& times,
            const TrackParameters& p);

  /// The object at a time [s], interpolated between its observations and continued beyond them.
  Pose pose(double t) const;  ///< T_world_object; x forward, z up
  Eigen::Vector3d velocity(double t) const;
  float speed(double t) const { return float(velocity(t).norm()); }

  /// Whether the position is known: between observations and a little outside, longer if it stands.
  bool covers(double t) const;
  /// Around what was seen of it near a time.
  OrientedBox box(double t) const;
  /// How well its place is known at an observation [m].
  double deviation(std::size_t observation) const { return states_[observation].deviation; }
  /// The same of what is seen of its surface, across itself [m]: a lorry may be known badly along
  /// its side, and the side well.
  double surface_deviation(std::size_t observation) const {
    return states_[observation].surface_deviation;
  }
  /// How far it surely goes from its first place, level, in all observations or in dynamic ones
  /// [m]. What is seen of a bush goes up and down, and a fence shows no shift along it.
  float distance(bool dynamic) const;

  /// The observations that are one object; of others nothing else is known.
  std::size_t begin() const { return begin_; }
  std::size_t end() const { return end_; }
  bool is_one_object() const { return begin_ == 0 && end_ == states_.size(); }

  bool is_rigid() const { return rigid_; }
  /// Whether ground was seen around it; then its heights are those over the ground.
  bool has_ground() const { return has_ground_; }
  /// Around all that was seen of it, in its own frame.
  const Extent& extent() const { return extent_; }

 private:
  struct State {
    double time;
    Eigen::Vector3d position, velocity;
    double heading, slope;         ///< of its x axis [rad]
    double deviation = 0;          ///< of the place [m]
    double surface_deviation = 0;  ///< of the surface, across itself [m]
  };

  /// Of each observation: the position, and the heading as the first coordinate.
  struct Measurements {
    std::vector<MeasuredPosition> positions, headings;

    void set(std::size_t k, const Registration& found, const State& state);
  };

  /// What an observation saw, all at its time.
  SeenSurface surface(std::size_t k) const {
    return seen_[k].held(states_[k].velocity.cast<float>());
  }
  void measure_shifts();
  void register_surfaces();
  std::size_t register_from(std::size_t first, int step, SurfaceModel& model,
                            Measurements& measured);
  void smooth(const Measurements& measured);
  void measure_surfaces(const SurfaceModel& model, const ExpectedPose& near);
  void find_extent(const SurfaceModel& model);
  void find_headings();
  void find_extents();
  Eigen::Vector3d turn_change(std::size_t k) const;
  Pose pose_of(std::size_t k) const;
  std::size_t after(double t) const;

  const Track& track_;
  const std::vector<double>& times_;
  const TrackParameters& p_;
  bool rigid_ = false, has_ground_ = false;
  std::size_t begin_ = 0, end_ = 0;
  const SeenSurface* seen_;  ///< of each observation, in the world
  std::vector<State> states_;
  std::vector<Extent> extents_;  ///< of each observation, in the frame of the object
  Extent extent_{Eigen::Vector3f::Zero(), Eigen::Vector3f::Zero()};
};

}  // namespace docdepth
