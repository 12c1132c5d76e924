#include "docdepth/paths/path_estimation.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "docdepth/detections/constants.hpp"
#include "docdepth/detections/quantile.hpp"
#include "docdepth/paths/smoothing.hpp"
#include "docdepth/tracking/neighbors.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Position = Eigen::Vector3d;

const Position kChange(kHorizontalChange, kHorizontalChange, kVerticalChange);

double wrapped(double angle) {
  return std::remainder(angle, 2 * M_PI);
}

/// Direction of the longest horizontal extent of points.
double longest_direction(const SampledPoints& points) {
  Vector mean = Vector::Zero();
  for (const Vector& p : points) mean += p / float(points.size());
  Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
  for (const Vector& p : points) {
    const Eigen::Vector2d off = (p - mean).head<2>().cast<double>();
    spread += off * off.transpose();
  }
  const Eigen::Vector2d axis =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(spread).eigenvectors().col(1);
  return std::atan2(axis.y(), axis.x());
}

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

bool is_known(const Height& height) {
  return std::isfinite(height.deviation);
}

/// A few normals that lean a little seem to tell the place by the height, which the ground tells.
void separate_height(Eigen::Matrix3d& covariance) {
  covariance.block<2, 1>(0, 2).setZero();
  covariance.block<1, 2>(2, 0).setZero();
}

/// A measured position of what stands on the ground.
MeasuredPosition grounded(MeasuredPosition seen, const Height& ground) {
  if (!is_known(ground)) return seen;
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

/// The heading of what moves, by its motion alone [rad].
struct MotionHeading {
  double value = 0, variance = std::numeric_limits<double>::infinity();
};

/// Of each observation: the position, and the heading as the first coordinate.
struct Measurements {
  std::vector<MeasuredPosition> positions, headings;

  void set(std::size_t k, const Registration& found, const PathState& state,
           const MotionHeading& by_motion);
};

class PathEstimation {
 public:
  PathEstimation(const Track& track, const SeenSurface* seen, const std::vector<double>& times)
      : track_(track), seen_(seen), times_(times) {}

  PathEstimate run();

 private:
  /// What an observation saw, all at its time.
  SeenSurface surface(std::size_t k) const {
    return seen_[k].held(path_.states[k].velocity.cast<float>());
  }
  void measure_shifts();
  void find_headings();
  void find_alone();
  void register_surfaces();
  std::size_t register_from(std::size_t first, int step, SurfaceModel& model,
                            Measurements& measured);
  void smooth(const Measurements& measured);
  void measure_surfaces(const SurfaceModel& model, const ExpectedPose& near);
  void share_surface_deviations(const std::vector<double>& measured);
  void find_extent(const SurfaceModel& model);
  void find_extents();
  Position turn_change(std::size_t k) const;

  const Track& track_;
  const SeenSurface* seen_;  ///< of each observation, in the world
  const std::vector<double>& times_;
  std::vector<MotionHeading> headings_;  ///< of each observation
  std::vector<std::uint8_t> alone_;      ///< whether an observation shows nothing but the object
  PathEstimate path_;
};

PathEstimate PathEstimation::run() {
  // A person who brushes a parked car is one object with it for a while: little of that passes.
  const auto are_wide = [](const std::vector<float>& widths) {
    return widths.size() > 2 && quantile(widths, kRigidQuantile) >= kMinRigidWidth;
  };
  std::vector<float> widths, passing;
  for (const TrackObservation& of : track_.observations) {
    widths.push_back(of.box.width());
    if (of.is_passing()) passing.push_back(of.box.width());
  }
  path_.passes_wide = passing.size() <= 2 || are_wide(passing);
  path_.rigid = are_wide(2 * passing.size() >= widths.size() ? passing : widths);
  path_.end = track_.observations.size();
  measure_shifts();
  find_headings();
  if (path_.rigid) register_surfaces();
  if (path_.is_one_object()) find_extents();
  return std::move(path_);
}

/// Sum the horizontal shifts from sweep to sweep. Heights are those of the ground, or of the lowest
/// points where no ground was seen.
void PathEstimation::measure_shifts() {
  std::vector<MeasuredPosition> measured;
  Position at = Position::Zero();
  double stamp = 0;  // of the observation before
  const auto& all = track_.observations;
  path_.has_ground = std::any_of(
      all.begin(), all.end(), [](const TrackObservation& seen) { return is_known(seen.ground); });
  const float unsure = float(path_.has_ground ? kHiddenDeviation : kHeightDeviation);
  for (const TrackObservation& seen : all) {
    const Height height = is_known(seen.ground) ? seen.ground : Height{seen.box.low.z(), unsure};
    const Eigen::Vector3d deviation(kShiftDeviation, kShiftDeviation, height.deviation);
    const double time = times_[seen.sweep] + seen.time_offset;
    if (measured.empty())
      at = (0.5f * (seen.box.low + seen.box.high)).cast<double>();
    else
      at +=
          (time - measured.back().time) / (times_[seen.sweep] - stamp) * seen.shift.cast<double>();
    stamp = times_[seen.sweep];
    measured.push_back({time,
                        {at.x(), at.y(), height.value},
                        Eigen::Vector3d(deviation.cwiseAbs2()).asDiagonal()});
  }
  const auto motions = smooth_positions(measured, {measured.size(), kChange});
  const double middle = 0.5 * double(measured.size() - 1);
  for (std::size_t k = 0; k < measured.size(); ++k) {
    const double drift = kShiftDrift * kShiftDrift * std::fabs(double(k) - middle);
    const double spread = motions[k].covariance.topLeftCorner<2, 2>().trace() + drift;
    path_.states.push_back({measured[k].time, motions[k].position, motions[k].velocity, 0, 0,
                            std::sqrt(spread), std::sqrt(spread), std::sqrt(spread)});
  }
}

/// Along the motion where it moves; where it stands, as it comes or goes.
void PathEstimation::find_headings() {
  const double least = path_.rigid ? kMinHeadingSpeed : kMinHeadingSpeed / 2;
  headings_.assign(path_.states.size(), {});
  std::vector<std::size_t> moving;
  for (std::size_t k = 0; k < path_.states.size(); ++k)
    if (path_.states[k].velocity.head<2>().norm() >= least) moving.push_back(k);
  if (moving.empty()) {
    const double heading = longest_direction(seen_[0].points);
    for (PathState& state : path_.states) state.heading = heading;
    return;
  }
  for (const std::size_t k : moving) {
    const Position& v = path_.states[k].velocity;
    path_.states[k].heading = std::atan2(v.y(), v.x());
    const double deviation = std::hypot(kMotionHeading, kCreep / v.head<2>().norm());
    headings_[k] = {path_.states[k].heading, deviation * deviation};
    if (path_.rigid)  // people are upright uphill, too
      path_.states[k].slope =
          std::clamp(std::atan2(v.z(), v.head<2>().norm()), -kSteepest, kSteepest);
  }
  std::size_t next = 0;
  for (std::size_t k = 0; k < path_.states.size(); ++k) {
    while (next + 1 < moving.size() && moving[next] < k) ++next;
    std::size_t nearest = moving[next];
    if (next > 0 && k - moving[next - 1] < (nearest > k ? nearest - k : k - nearest))
      nearest = moving[next - 1];
    path_.states[k].heading = path_.states[nearest].heading;
    path_.states[k].slope = path_.states[nearest].slope;
  }
  for (std::size_t k = 1; k < path_.states.size(); ++k)
    path_.states[k].heading = path_.states[k - 1].heading +
                              wrapped(path_.states[k].heading - path_.states[k - 1].heading);
}

/// An observation that is wider than any vehicle shows what stands beside the object, too. Where
/// all are, they are taken as they are.
void PathEstimation::find_alone() {
  for (std::size_t k = 0; k < path_.states.size(); ++k)
    alone_.push_back(!are_too_wide({&seen_[k].points}));
  if (std::count(alone_.begin(), alone_.end(), 1) == 0) alone_.assign(alone_.size(), 1);
}

/// Register the surfaces of all observations, from the one that shows most of the object outward:
/// each where the motion so far leads. Then all once more onto the whole model.
void PathEstimation::register_surfaces() {
  const auto& seen = track_.observations;
  find_alone();
  std::size_t first = 0;
  float width = 0;
  for (std::size_t k = 0; k < seen.size(); ++k) {
    if (!alone_[k]) continue;
    if (!alone_[first] || seen[k].area > seen[first].area) first = k;
    width = std::max(width, seen[k].box.width());
  }
  if (!has_normals(seen_[first])) return;  // the shifts have to do
  SurfaceModel model(std::max(kSampleSpacing, width / kModelVoxels));
  Measurements measured{std::vector<MeasuredPosition>(path_.states.size()),
                        std::vector<MeasuredPosition>(path_.states.size())};
  const double exact = kSurfaceDeviation * kSurfaceDeviation;
  measured.positions[first] = {path_.states[first].time, path_.states[first].position,
                               Eigen::Matrix3d::Identity() * exact};
  measured.headings[first] = {path_.states[first].time,
                              {path_.states[first].heading, 0, 0},
                              Eigen::Vector3d(exact, 1, 1).asDiagonal()};
  model.add(surface(first), path_.states[first].pose());
  path_.end = register_from(first, 1, model, measured);
  path_.begin = register_from(first, -1, model, measured) + 1;
  if (!path_.is_one_object()) return;  // the others are something else
  smooth(measured);
  const ExpectedPose near{Pose::Identity(),
                          Eigen::Matrix3d::Identity() * kGuessDeviation * kGuessDeviation,
                          kGuessHeadingDeviation * kGuessHeadingDeviation};
  for (std::size_t k = 0; k < path_.states.size(); ++k) {
    const ExpectedPose expected{path_.states[k].pose(), near.covariance, near.heading_variance};
    measured.set(k, register_surface(surface(k), model, expected), path_.states[k], headings_[k]);
  }
  smooth(measured);
  measure_surfaces(model, near);
  find_extent(model);
}

/// Register surfaces onto the model from one observation on, forward or backward in time.
/// @return the first observation that is something else
std::size_t PathEstimation::register_from(std::size_t first, int step, SurfaceModel& model,
                                          Measurements& measured) {
  MotionFilter motion, turn;
  motion.start(measured.positions[first], path_.states[first].velocity, kShiftSpeedDeviation);
  turn.start(measured.headings[first], Position::Zero(), kStrongestTurn);
  std::size_t misses = 0, last = first;
  Pose T_last = path_.states[first].pose();
  for (std::size_t k = first + std::size_t(step); k < path_.states.size(); k += std::size_t(step)) {
    const double time = path_.states[k].time;
    const SeenSurface seen = surface(k);
    motion.predict(time, kChange), turn.predict(time, turn_change(k));
    if (const Height& ground = track_.observations[k].ground; is_known(ground))
      motion.update_height(ground.value, ground.deviation);
    Pose guess = upright_pose(motion.position(), turn.position().x(), path_.states[k].slope);
    ++misses;
    if (lies_on(seen.points, model, guess)) {
      misses = 0;
    } else {
      // The motion has lost it: as the shifts say, if it can have gone there.
      const Pose shifted = T_last * path_.states[last].pose().inverse() * path_.states[k].pose();
      const double dt = time - path_.states[last].time;
      const double reach = kSearchMargin + kMaxAcceleration * dt * dt / 2;
      if ((shifted.translation() - guess.translation()).head<2>().norm() <= reach &&
          lies_on(seen.points, model, shifted))
        guess = shifted, misses = 0;
    }
    if (misses == kMaxMisses) return k - (misses - 1) * std::size_t(step);
    const auto registered = [&](const Pose& expected) {
      return register_surface(seen, model,
                              {expected, motion.covariance(), turn.covariance()(0, 0)});
    };
    Registration found = registered(guess);
    // Along a flat side the motion may go on though the object has stopped. Then the surface fits
    // where the shifts lead.
    const double speed = motion.velocity().norm();
    const bool slower = speed >= kSlow && path_.states[k].velocity.norm() < speed / 2;
    if (misses == 0 && slower &&
        (found.position - path_.states[k].position).head<2>().norm() > kMaxDrift) {
      const Registration there = registered(path_.states[k].pose());
      if (there.share > found.share) {
        found = there;
        motion.start({time, found.position, found.covariance}, path_.states[k].velocity,
                     kShiftSpeedDeviation);
      }
    }
    measured.set(k, found, {time, {}, {}, turn.position().x(), 0}, headings_[k]);
    MeasuredPosition& position = measured.positions[k];
    if (is_known(track_.observations[k].ground)) separate_height(position.covariance);
    if (!motion.expects(position)) position.covariance *= kOutlierFactor;
    motion.update(position), turn.update(measured.headings[k]);
    if (misses > 0) continue;
    last = k, T_last = found.T_world_object;
    if (found.share >= kMinRegisteredShare && alone_[k]) model.add(seen, found.T_world_object);
  }
  return step > 0 ? path_.states.size() : std::size_t(-1);
}

/// What a registration measured. Headings go on from that of the state, so that they do not jump by
/// a turn. The motion tells the heading, too.
void Measurements::set(std::size_t k, const Registration& found, const PathState& state,
                       const MotionHeading& by_motion) {
  const double factor = found.share >= kMinRegisteredShare ? 1 : kOutlierFactor;
  double heading = state.heading + wrapped(found.heading - state.heading);
  double variance = factor * found.heading_variance;
  const double share = variance / (variance + by_motion.variance);
  heading += share * wrapped(by_motion.value - heading), variance *= 1 - share;
  positions[k] = {state.time, found.position, factor * found.covariance};
  headings[k] = {state.time, {heading, 0, 0}, Eigen::Vector3d(variance, 1, 1).asDiagonal()};
}

/// The motion through measured positions and headings. Vertical sides tell nothing of the height,
/// the ground does.
void PathEstimation::smooth(const Measurements& measured) {
  std::vector<MeasuredPosition> positions;
  for (std::size_t k = 0; k < path_.states.size(); ++k)
    positions.push_back(grounded(measured.positions[k], track_.observations[k].ground));
  const auto& headings = measured.headings;
  std::vector<Position> turn_changes;
  for (std::size_t k = 0; k < path_.states.size(); ++k) turn_changes.push_back(turn_change(k));
  const auto motions = smooth_positions(positions, {positions.size(), kChange});
  const auto turns = smooth_positions(headings, turn_changes);
  for (std::size_t k = 0; k < path_.states.size(); ++k) {
    path_.states[k].position = motions[k].position;
    path_.states[k].velocity = motions[k].velocity;
    path_.states[k].heading = turns[k].position.x();
    const double of_position = motions[k].covariance.topLeftCorner<2, 2>().trace();
    const double of_ends = kHalfLength * kHalfLength * turns[k].covariance(0, 0);
    path_.states[k].least_deviation = std::sqrt(of_position + of_ends);
    path_.states[k].deviation = std::sqrt(kSweepsAlike * of_position + of_ends);
  }
}

/// How far each surface lies beside the model, where the path says that it is. What is not known
/// along a flat side, or of a heading where little was seen, does not count.
void PathEstimation::measure_surfaces(const SurfaceModel& model, const ExpectedPose& near) {
  std::vector<double> measured(path_.states.size());
  for (std::size_t k = 0; k < path_.states.size(); ++k) {
    path_.states[k].surface_deviation = path_.states[k].deviation;
    const SeenSurface seen = surface(k);
    const Pose T = path_.states[k].pose();
    const Registration found =
        register_surface(seen, model, {T, near.covariance, near.heading_variance});
    if (found.share < kMinRegisteredShare) continue;
    const Eigen::Isometry3f moved = (found.T_world_object * T.inverse()).cast<float>();
    double sum = 0, count = 0;
    for (std::size_t i = 0; i < seen.points.size(); ++i) {
      if (seen.normals[i].isZero(0)) continue;
      const double off = seen.normals[i].dot(moved * seen.points[i] - seen.points[i]);
      sum += off * off, ++count;
    }
    if (count == 0) continue;
    measured[k] = std::sqrt(sum / count);
    path_.states[k].surface_deviation =
        std::sqrt((sum + kResidualDeviation * kResidualDeviation) / count);
  }
  share_surface_deviations(measured);
}

/// A sweep that shows little of a surface, or nothing that can be registered, tells little of where
/// it is. The sweeps around it do; meanwhile the path bends by kStrongest at most. Where the sweep
/// measured an offset, the deviation is at least that.
void PathEstimation::share_surface_deviations(const std::vector<double>& measured) {
  std::vector<double> shared;
  for (std::size_t k = 0; k < path_.states.size(); ++k) {
    double least = path_.states[k].surface_deviation;
    for (const int step : {-1, 1})
      for (std::size_t j = k + std::size_t(step); j < path_.states.size(); j += std::size_t(step)) {
        const double dt = path_.states[j].time - path_.states[k].time;
        const double bent = kStrongest / 2 * dt * dt;
        if (bent >= least) break;
        least = std::min(least, path_.states[j].surface_deviation + bent);
      }
    shared.push_back(std::max(least, measured[k]));
  }
  for (std::size_t k = 0; k < shared.size(); ++k) path_.states[k].surface_deviation = shared[k];
}

/// Around what several sweeps saw of the object.
void PathEstimation::find_extent(const SurfaceModel& model) {
  std::vector<float> sides[3];
  // Where most was seen by fewer sweeps, as petals of a rosette see what is fast, fewer are enough.
  const int typical = int(quantile(model.hits(), 0.5));
  const int least = std::min({kMinHits, 1 + int(path_.states.size()) / kMinHits, typical});
  for (std::size_t i = 0; i < model.hits().size(); ++i)
    for (int axis = 0; axis < 3 && model.hits()[i] >= least; ++axis)
      sides[axis].push_back(model.surface().points[i][axis]);
  for (int axis = 0; axis < 3 && !sides[0].empty(); ++axis) {
    path_.extent.low[axis] = quantile(sides[axis], 1 - kExtentQuantile);
    path_.extent.high[axis] = quantile(sides[axis], kExtentQuantile);
  }
}

/// As measured, not held: what a sweep shows of the object is looked for in these boxes.
void PathEstimation::find_extents() {
  const bool is_known = path_.rigid && path_.extent.size().minCoeff() > 0;
  std::vector<float> sides[6];
  for (std::size_t k = 0; k < path_.states.size(); ++k) {
    path_.extents.push_back(extent_in(seen_[k].points, path_.states[k].pose()));
    if (is_known && !alone_[k]) path_.extents[k] = path_.extents[k].clipped(path_.extent);
    for (int axis = 0; axis < 3; ++axis) {
      sides[axis].push_back(path_.extents[k].low[axis]);
      sides[3 + axis].push_back(path_.extents[k].high[axis]);
    }
  }
  if (!is_known)
    for (int axis = 0; axis < 3; ++axis) {
      path_.extent.low[axis] = quantile(sides[axis], 1 - kRigidQuantile);
      path_.extent.high[axis] = quantile(sides[3 + axis], kRigidQuantile);
    }
}

/// What stands does not turn.
Position PathEstimation::turn_change(std::size_t k) const {
  const double speed = std::max(path_.states[k].velocity.head<2>().norm(),
                                path_.states[k > 0 ? k - 1 : k].velocity.head<2>().norm());
  return Position::Constant(kTurnChange * std::clamp(speed / kMinHeadingSpeed, kStandingTurn, 1.0));
}

}  // namespace

PathEstimate estimate_path(const Track& track, const SeenSurface* seen,
                           const std::vector<double>& times) {
  return PathEstimation(track, seen, times).run();
}

Pose upright_pose(const Eigen::Vector3d& position, double heading, double slope) {
  Pose T = Pose::Identity();
  T.translate(position);
  T.rotate(Eigen::AngleAxisd(heading, Position::UnitZ()));
  T.rotate(Eigen::AngleAxisd(-slope, Position::UnitY()));
  return T;
}

}  // namespace docdepth
