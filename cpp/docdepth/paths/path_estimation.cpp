#include "docdepth/paths/path_estimation.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "docdepth/detections/quantile.hpp"
#include "docdepth/paths/shifted_path.hpp"
#include "docdepth/tracking/constants.hpp"
#include "docdepth/tracking/motion_filter.hpp"
#include "docdepth/tracking/neighbors.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Position = Eigen::Vector3d;

/// Whether most samples of a surface lie in triangles: those of others cannot be registered.
bool has_normals(const SampledSurface& surface) {
  const auto known = [](const Vector& normal) { return !normal.isZero(0); };
  return 2 * std::count_if(surface.normals.begin(), surface.normals.end(), known) >=
         std::ptrdiff_t(surface.normals.size());
}

/// Whether most of some points lie where the model is.
bool lies_on(const SampledPoints& points, const SurfaceModel& model, const Pose& T_world_object) {
  Extent box = extent_of(model.surface().points);
  box.low -= Vector::Constant(kSearchMargin);
  box.high += Vector::Constant(kSearchMargin);
  const Eigen::Isometry3f T = T_world_object.inverse().cast<float>();
  std::size_t inside = 0;
  for (const Vector& point : points) {
    const Vector p = T * point;
    inside += (p.array() >= box.low.array()).all() && (p.array() <= box.high.array()).all();
  }
  return 2 * inside >= points.size();
}

/// A few normals that lean a little seem to tell the place by the height, which the ground tells.
void separate_height(Eigen::Matrix3d& covariance) {
  covariance.block<2, 1>(0, 2).setZero();
  covariance.block<1, 2>(2, 0).setZero();
}

/// A measured position of what stands on the ground.
MeasuredPosition grounded(MeasuredPosition seen, const GroundHeight& ground) {
  if (!ground.is_known()) return seen;
  separate_height(seen.covariance);
  double& variance = seen.covariance(2, 2);
  const double share = variance / (variance + double(ground.deviation) * ground.deviation);
  seen.position.z() += share * (ground.value - seen.position.z());
  variance *= 1 - share;
  return seen;
}

Extent extent_in(const SampledPoints& points, const Pose& T_world_object) {
  const Eigen::Isometry3f T = T_world_object.inverse().cast<float>();
  Extent box{T * points.front(), T * points.front()};
  for (const Vector& p : points) box.add({T * p, T * p});
  return box;
}

/// Of each observation: the position, and the heading as the first coordinate.
struct Measurements {
  std::vector<MeasuredPosition> positions, headings;
};

class PathEstimation {
 public:
  PathEstimation(const Track& track, std::span<const ObservedSurface> surfaces,
                 const std::vector<double>& times, const PathOptions& options)
      : observations_(track.observations),
        surfaces_(surfaces),
        options_(options),
        change_(acceleration_change(options)) {
    ShiftedPath shifted = path_by_shifts(track, surfaces, times, options);
    path_ = std::move(shifted.path);
    headings_ = std::move(shifted.headings);
  }

  std::variant<Path, Cut> run();

 private:
  int count() const { return int(observations_.size()); }
  /// What an observation saw, all at its time.
  ObservedSurface surface(int k) const {
    return surfaces_[k].deskewed(path_.states[k].velocity.cast<float>());
  }
  void find_unmerged();
  std::optional<Cut> align_surfaces();
  int first_surface() const;
  int align_from(int first, int step, SurfaceModel& model, Measurements& measured);
  bool follow_shifts(const ObservedSurface& seen, const SurfaceModel& model, int k, int last,
                     const Pose& T_last, Pose& guess) const;
  void set(Measurements& measured, int k, const SurfaceAlignment& found,
           const PathState& state) const;
  void smooth(const Measurements& measured);
  void measure_surfaces(const SurfaceModel& model, const ExpectedPose& near);
  void share_surface_deviations(const std::vector<double>& measured);
  void find_extent(const SurfaceModel& model);
  void find_extents();
  Position turn_change(int k) const;

  std::vector<TrackObservation> observations_;
  std::span<const ObservedSurface> surfaces_;  ///< of each observation, in the world
  PathOptions options_;
  Position change_;                      ///< of the acceleration in a second [m/s^2]
  std::vector<MotionHeading> headings_;  ///< of each observation
  std::vector<std::uint8_t> unmerged_;   ///< whether an observation shows nothing but the object
  Path path_;
};

std::variant<Path, Cut> PathEstimation::run() {
  if (path_.rigid)
    if (const auto cut = align_surfaces()) return *cut;
  find_extents();
  return std::move(path_);
}

/// An observation that is wider than any vehicle shows what stands beside the object, too. Where
/// all are, they are taken as they are.
void PathEstimation::find_unmerged() {
  for (int k = 0; k < count(); ++k) unmerged_.push_back(!are_too_wide({&surfaces_[k].points}));
  if (std::count(unmerged_.begin(), unmerged_.end(), 1) == 0) unmerged_.assign(unmerged_.size(), 1);
}

/// The observation that shows most of the object.
int PathEstimation::first_surface() const {
  int first = 0;
  for (int k = 0; k < count(); ++k)
    if (unmerged_[k] && (!unmerged_[first] || observations_[k].area > observations_[first].area))
      first = k;
  return first;
}

/// Align the surfaces of all observations, from the one that shows most of the object outward: each
/// where the motion so far leads. Then all once more with the whole model.
std::optional<Cut> PathEstimation::align_surfaces() {
  find_unmerged();
  const int first = first_surface();
  float width = 0;
  for (int k = 0; k < count(); ++k)
    if (unmerged_[k]) width = std::max(width, observations_[k].box.width());
  if (!has_normals(surfaces_[first])) return std::nullopt;  // the shifts have to do
  SurfaceModel model(std::max(kSampleSpacing, width / options_.model_voxels));
  Measurements measured{std::vector<MeasuredPosition>(path_.states.size()),
                        std::vector<MeasuredPosition>(path_.states.size())};
  const double deviation = options_.alignment.surface_deviation, exact = deviation * deviation;
  measured.positions[first] = {path_.states[first].time, path_.states[first].position,
                               Eigen::Matrix3d::Identity() * exact};
  measured.headings[first] = {path_.states[first].time,
                              {path_.states[first].heading, 0, 0},
                              Eigen::Vector3d(exact, 1, 1).asDiagonal()};
  model.add(surface(first), path_.states[first].pose());
  const int end = align_from(first, 1, model, measured);
  const int begin = align_from(first, -1, model, measured) + 1;
  if (begin > 0 || end < count()) return Cut{std::size_t(begin), std::size_t(end)};
  smooth(measured);
  const ExpectedPose near{
      Pose::Identity(),
      Eigen::Matrix3d::Identity() * options_.guess_deviation * options_.guess_deviation,
      options_.guess_heading_deviation * options_.guess_heading_deviation};
  for (int k = 0; k < count(); ++k) {
    const ExpectedPose expected{path_.states[k].pose(), near.covariance, near.heading_variance};
    set(measured, k, align_surface(surface(k), model, expected, options_.alignment),
        path_.states[k]);
  }
  smooth(measured);
  measure_surfaces(model, near);
  find_extent(model);
  return std::nullopt;
}

/// Whether a surface lies on the model where the shifts lead from the last one that did, which the
/// object can have reached; then the guess is moved there.
bool PathEstimation::follow_shifts(const ObservedSurface& seen, const SurfaceModel& model, int k,
                                   int last, const Pose& T_last, Pose& guess) const {
  const Pose shifted = T_last * path_.states[last].pose().inverse() * path_.states[k].pose();
  const double dt = path_.states[k].time - path_.states[last].time;
  const double reach = kSearchMargin + kMaxAcceleration * dt * dt / 2;
  if ((shifted.translation() - guess.translation()).head<2>().norm() > reach ||
      !lies_on(seen.points, model, shifted))
    return false;
  guess = shifted;
  return true;
}

/// Align surfaces with the model from one observation on, forward or backward in time.
/// @return the first observation that is something else; -1 or the number of observations if none
/// is
int PathEstimation::align_from(int first, int step, SurfaceModel& model, Measurements& measured) {
  MotionFilter motion, turn;
  motion.start(measured.positions[first], path_.states[first].velocity,
               options_.shift_speed_deviation);
  turn.start(measured.headings[first], Position::Zero(), options_.strongest_turn);
  int misses = 0, last = first;
  Pose T_last = path_.states[first].pose();
  for (int k = first + step; k >= 0 && k < count(); k += step) {
    const PathState& state = path_.states[k];
    const ObservedSurface seen = surface(k);
    motion.predict(state.time, change_);
    turn.predict(state.time, turn_change(k));
    const GroundHeight& ground = observations_[k].ground;
    if (ground.is_known()) motion.update_height(ground.value, ground.deviation);
    Pose guess = upright_pose(motion.position(), turn.position().x(), state.slope);
    const bool found_it =
        lies_on(seen.points, model, guess) || follow_shifts(seen, model, k, last, T_last, guess);
    misses = found_it ? 0 : misses + 1;
    if (misses == options_.max_misses) return k - (misses - 1) * step;
    const auto align = [&](const Pose& expected) {
      return align_surface(seen, model, {expected, motion.covariance(), turn.covariance()(0, 0)},
                           options_.alignment);
    };
    SurfaceAlignment found = align(guess);
    // Along a flat side the motion may go on though the object has stopped. Then the surface fits
    // where the shifts lead.
    const double speed = motion.velocity().norm();
    const bool slower = speed >= kSlow && state.velocity.norm() < speed / 2;
    if (misses == 0 && slower &&
        (found.position - state.position).head<2>().norm() > options_.max_drift) {
      const SurfaceAlignment there = align(state.pose());
      if (there.share > found.share) {
        found = there;
        motion.start({state.time, found.position, found.covariance}, state.velocity,
                     options_.shift_speed_deviation);
      }
    }
    set(measured, k, found, {.time = state.time, .heading = turn.position().x()});
    MeasuredPosition& position = measured.positions[k];
    if (ground.is_known()) separate_height(position.covariance);
    if (!motion.expects(position)) position.covariance *= options_.outlier_factor;
    motion.update(position);
    turn.update(measured.headings[k]);
    if (misses > 0) continue;
    last = k;
    T_last = found.T_world_object;
    if (found.share >= options_.min_aligned_share && unmerged_[k])
      model.add(seen, found.T_world_object);
  }
  return step > 0 ? count() : -1;
}

/// What an alignment measured. Headings go on from that of the state, so that they do not jump by a
/// turn. The motion tells the heading, too.
void PathEstimation::set(Measurements& measured, int k, const SurfaceAlignment& found,
                         const PathState& state) const {
  const MotionHeading& by_motion = headings_[k];
  const double factor = found.share >= options_.min_aligned_share ? 1 : options_.outlier_factor;
  double heading = state.heading + wrapped(found.heading - state.heading);
  double variance = factor * found.heading_variance;
  const double share = variance / (variance + by_motion.variance);
  heading += share * wrapped(by_motion.value - heading);
  variance *= 1 - share;
  measured.positions[k] = {state.time, found.position, factor * found.covariance};
  measured.headings[k] = {
      state.time, {heading, 0, 0}, Eigen::Vector3d(variance, 1, 1).asDiagonal()};
}

/// The motion through measured positions and headings. Vertical sides tell nothing of the height,
/// the ground does.
void PathEstimation::smooth(const Measurements& measured) {
  std::vector<MeasuredPosition> positions;
  for (int k = 0; k < count(); ++k)
    positions.push_back(grounded(measured.positions[k], observations_[k].ground));
  const auto& headings = measured.headings;
  std::vector<Position> turn_changes;
  for (int k = 0; k < count(); ++k) turn_changes.push_back(turn_change(k));
  const auto motions = smooth_positions(positions, {positions.size(), change_});
  const auto turns = smooth_positions(headings, turn_changes);
  for (int k = 0; k < count(); ++k) {
    path_.states[k].position = motions[k].position;
    path_.states[k].velocity = motions[k].velocity;
    path_.states[k].heading = turns[k].position.x();
    const double of_position = motions[k].covariance.topLeftCorner<2, 2>().trace();
    const double of_ends = options_.half_length * options_.half_length * turns[k].covariance(0, 0);
    path_.states[k].independent_deviation = std::sqrt(of_position + of_ends);
    path_.states[k].deviation = std::sqrt(options_.correlated_sweeps * of_position + of_ends);
  }
}

/// How far each surface lies beside the model, where the path says that it is. What is not known
/// along a flat side, or of a heading where little was seen, does not count.
void PathEstimation::measure_surfaces(const SurfaceModel& model, const ExpectedPose& near) {
  std::vector<double> measured(path_.states.size());
  for (int k = 0; k < count(); ++k) {
    path_.states[k].surface_deviation = path_.states[k].deviation;
    const ObservedSurface seen = surface(k);
    const Pose T = path_.states[k].pose();
    const SurfaceAlignment found =
        align_surface(seen, model, {T, near.covariance, near.heading_variance}, options_.alignment);
    if (found.share < options_.min_aligned_share) continue;
    const Eigen::Isometry3f moved = (found.T_world_object * T.inverse()).cast<float>();
    double sum = 0, used = 0;
    for (std::size_t i = 0; i < seen.points.size(); ++i) {
      if (seen.normals[i].isZero(0)) continue;
      const double off = seen.normals[i].dot(moved * seen.points[i] - seen.points[i]);
      sum += off * off;
      ++used;
    }
    if (used == 0) continue;
    measured[k] = std::sqrt(sum / used);
    const double deviation = options_.alignment.residual_deviation;
    path_.states[k].surface_deviation = std::sqrt((sum + deviation * deviation) / used);
  }
  share_surface_deviations(measured);
}

/// A sweep that shows little of a surface, or nothing that can be registered, tells little of where
/// it is. The sweeps around it do; meanwhile the path bends by MotionFilter::kStrongest at most.
/// Where the sweep measured an offset, the deviation is at least that.
void PathEstimation::share_surface_deviations(const std::vector<double>& measured) {
  std::vector<double> shared;
  for (int k = 0; k < count(); ++k) {
    double least = path_.states[k].surface_deviation;
    for (const PathState& other : path_.states) {
      const double dt = other.time - path_.states[k].time;
      const double bent = MotionFilter::kStrongest / 2 * dt * dt;
      least = std::min(least, other.surface_deviation + bent);
    }
    shared.push_back(std::max(least, measured[k]));
  }
  for (int k = 0; k < count(); ++k) path_.states[k].surface_deviation = shared[k];
}

/// Around what several sweeps saw of the object.
void PathEstimation::find_extent(const SurfaceModel& model) {
  std::vector<float> sides[3];
  // Where most was seen by fewer sweeps, as petals of a rosette see what is fast, fewer are enough.
  const int typical = int(quantile(model.hits(), 0.5));
  const int least = std::min({options_.min_hits, 1 + count() / options_.min_hits, typical});
  for (std::size_t i = 0; i < model.hits().size(); ++i)
    for (int axis = 0; axis < 3 && model.hits()[i] >= least; ++axis)
      sides[axis].push_back(model.surface().points[i][axis]);
  for (int axis = 0; axis < 3 && !sides[0].empty(); ++axis) {
    path_.extent.low[axis] = quantile(sides[axis], 1 - options_.extent_quantile);
    path_.extent.high[axis] = quantile(sides[axis], options_.extent_quantile);
  }
}

/// As measured, not held: what a sweep shows of the object is looked for in these boxes.
void PathEstimation::find_extents() {
  const bool is_known = path_.rigid && path_.extent.size().minCoeff() > 0;
  std::vector<float> sides[6];
  for (int k = 0; k < count(); ++k) {
    path_.extents.push_back(extent_in(surfaces_[k].points, path_.states[k].pose()));
    if (is_known && !unmerged_[k]) path_.extents[k] = path_.extents[k].clipped(path_.extent);
    for (int axis = 0; axis < 3; ++axis) {
      sides[axis].push_back(path_.extents[k].low[axis]);
      sides[3 + axis].push_back(path_.extents[k].high[axis]);
    }
  }
  if (!is_known)
    for (int axis = 0; axis < 3; ++axis) {
      path_.extent.low[axis] = quantile(sides[axis], 1 - options_.rigid_quantile);
      path_.extent.high[axis] = quantile(sides[3 + axis], options_.rigid_quantile);
    }
}

/// What stands does not turn.
Position PathEstimation::turn_change(int k) const {
  const double speed = std::max(path_.states[k].velocity.head<2>().norm(),
                                path_.states[k > 0 ? k - 1 : k].velocity.head<2>().norm());
  return Position::Constant(options_.turn_change * std::clamp(speed / options_.min_heading_speed,
                                                              options_.standing_turn, 1.0));
}

}  // namespace

std::variant<Path, Cut> estimate_path(const Track& track, std::span<const ObservedSurface> surfaces,
                                      const std::vector<double>& times,
                                      const PathOptions& options) {
  return PathEstimation(track, surfaces, times, options).run();
}

Pose upright_pose(const Eigen::Vector3d& position, double heading, double slope) {
  Pose T = Pose::Identity();
  T.translate(position);
  T.rotate(Eigen::AngleAxisd(heading, Position::UnitZ()));
  T.rotate(Eigen::AngleAxisd(-slope, Position::UnitY()));
  return T;
}

}  // namespace docdepth
