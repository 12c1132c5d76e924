#include "docdepth/objects/track_path.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "docdepth/objects/constants.hpp"
#include "docdepth/objects/quantile.hpp"
#include "docdepth/objects/registration.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Position = Eigen::Vector3d;

const Position kChange(kHorizontalChange, kHorizontalChange, kVerticalChange);

double wrapped(double angle) {
  return std::remainder(angle, 2 * M_PI);
}

Pose standing_pose(const Position& position, double heading, double slope) {
  Pose T = Pose::Identity();
  T.translate(position);
  T.rotate(Eigen::AngleAxisd(heading, Position::UnitZ()));
  T.rotate(Eigen::AngleAxisd(-slope, Position::UnitY()));
  return T;
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

}  // namespace

TrackPath::TrackPath(const Track& track, const SeenSurface* seen, const std::vector<double>& times,
                     const TrackParameters& p)
    : track_(track), times_(times), p_(p), seen_(seen) {
  std::vector<float> widths;
  for (const TrackObservation& of : track.observations) widths.push_back(of.box.width());
  rigid_ = quantile(widths, kRigidQuantile) >= kMinRigidWidth && track.observations.size() > 2;
  end_ = track.observations.size();
  measure_shifts();
  find_headings();
  if (rigid_) register_surfaces();
  if (is_one_object()) find_extents();
  seen_ = nullptr;
}

/// Sum the shifts from sweep to sweep, which are horizontal. Heights are those of the ground, or of
/// the lowest points where no ground was seen.
void TrackPath::measure_shifts() {
  std::vector<MeasuredPosition> measured;
  Position at = Position::Zero();
  const auto& all = track_.observations;
  has_ground_ = std::any_of(all.begin(), all.end(),
                            [](const TrackObservation& seen) { return is_known(seen.ground); });
  const float unsure = float(has_ground_ ? kHiddenDeviation : kHeightDeviation);
  for (const TrackObservation& seen : all) {
    const Height height = is_known(seen.ground) ? seen.ground : Height{seen.box.low.z(), unsure};
    const Eigen::Vector3d deviation(kShiftDeviation, kShiftDeviation, height.deviation);
    if (measured.empty())
      at = (0.5f * (seen.box.low + seen.box.high)).cast<double>();
    else
      at += seen.shift.cast<double>();
    const double time = times_[seen.sweep] + seen.time_offset;
    measured.push_back({time,
                        {at.x(), at.y(), height.value},
                        Eigen::Vector3d(deviation.cwiseAbs2()).asDiagonal()});
  }
  const auto motions = smooth_positions(measured, {measured.size(), kChange});
  const double middle = 0.5 * double(measured.size() - 1);
  for (std::size_t k = 0; k < measured.size(); ++k) {
    const double drift = kShiftDrift * kShiftDrift * std::fabs(double(k) - middle);
    const double spread = motions[k].covariance.topLeftCorner<2, 2>().trace() + drift;
    states_.push_back({measured[k].time, motions[k].position, motions[k].velocity, 0, 0,
                       std::sqrt(spread), std::sqrt(spread)});
  }
}

/// Along the motion where it moves; where it stands, as it comes or goes.
void TrackPath::find_headings() {
  const double least = rigid_ ? kMinHeadingSpeed : kMinHeadingSpeed / 2;
  std::vector<std::size_t> moving;
  for (std::size_t k = 0; k < states_.size(); ++k)
    if (states_[k].velocity.head<2>().norm() >= least) moving.push_back(k);
  if (moving.empty()) {
    const double heading = longest_direction(seen_[0].points);
    for (State& state : states_) state.heading = heading;
    return;
  }
  for (const std::size_t k : moving) {
    const Position& v = states_[k].velocity;
    states_[k].heading = std::atan2(v.y(), v.x());
    if (rigid_)  // people are upright uphill, too
      states_[k].slope = std::clamp(std::atan2(v.z(), v.head<2>().norm()), -kSteepest, kSteepest);
  }
  std::size_t next = 0;
  for (std::size_t k = 0; k < states_.size(); ++k) {
    while (next + 1 < moving.size() && moving[next] < k) ++next;
    std::size_t nearest = moving[next];
    if (next > 0 && k - moving[next - 1] < (nearest > k ? nearest - k : k - nearest))
      nearest = moving[next - 1];
    states_[k].heading = states_[nearest].heading;
    states_[k].slope = states_[nearest].slope;
  }
  for (std::size_t k = 1; k < states_.size(); ++k)
    states_[k].heading =
        states_[k - 1].heading + wrapped(states_[k].heading - states_[k - 1].heading);
}

/// Register the surfaces of all observations, from the one that shows most of the object outward:
/// each where the motion so far leads. Then all once more onto the whole model.
void TrackPath::register_surfaces() {
  const auto& seen = track_.observations;
  const auto smaller = [](const auto& a, const auto& b) { return a.area < b.area; };
  const auto first =
      std::size_t(std::max_element(seen.begin(), seen.end(), smaller) - seen.begin());
  if (!has_normals(seen_[first])) return;  // the shifts have to do
  float width = 0;
  for (const TrackObservation& of : seen) width = std::max(width, of.box.width());
  SurfaceModel model(std::max(kSampleSpacing, width / kModelVoxels));
  Measurements measured{std::vector<MeasuredPosition>(states_.size()),
                        std::vector<MeasuredPosition>(states_.size())};
  const double exact = kSurfaceDeviation * kSurfaceDeviation;
  measured.positions[first] = {states_[first].time, states_[first].position,
                               Eigen::Matrix3d::Identity() * exact};
  measured.headings[first] = {states_[first].time,
                              {states_[first].heading, 0, 0},
                              Eigen::Vector3d(exact, 1, 1).asDiagonal()};
  model.add(surface(first), pose_of(first));
  end_ = register_from(first, 1, model, measured);
  begin_ = register_from(first, -1, model, measured) + 1;
  if (!is_one_object()) return;  // the others are something else
  smooth(measured);
  const ExpectedPose near{Pose::Identity(),
                          Eigen::Matrix3d::Identity() * kGuessDeviation * kGuessDeviation,
                          kGuessHeadingDeviation * kGuessHeadingDeviation};
  for (std::size_t k = 0; k < states_.size(); ++k) {
    const ExpectedPose expected{pose_of(k), near.covariance, near.heading_variance};
    measured.set(k, register_surface(surface(k), model, expected), states_[k]);
  }
  smooth(measured);
  measure_surfaces(model, near);
  find_extent(model);
}

/// Register surfaces onto the model from one observation on, forward or backward in time.
/// @return the first observation that is something else
std::size_t TrackPath::register_from(std::size_t first, int step, SurfaceModel& model,
                                     Measurements& measured) {
  MotionFilter motion, turn;
  motion.start(measured.positions[first], states_[first].velocity, kShiftSpeedDeviation);
  turn.start(measured.headings[first], Position::Zero(), kStrongestTurn);
  std::size_t misses = 0, last = first;
  Pose T_last = pose_of(first);
  for (std::size_t k = first + std::size_t(step); k < states_.size(); k += std::size_t(step)) {
    const double time = states_[k].time;
    const SeenSurface seen = surface(k);
    motion.predict(time, kChange), turn.predict(time, turn_change(k));
    if (const Height& ground = track_.observations[k].ground; is_known(ground))
      motion.update_height(ground.value, ground.deviation);
    Pose guess = standing_pose(motion.position(), turn.position().x(), states_[k].slope);
    ++misses;
    if (lies_on(seen.points, model, guess)) {
      misses = 0;
    } else {
      // The motion has lost it: as the shifts say, if it can have gone there.
      const Pose shifted = T_last * pose_of(last).inverse() * pose_of(k);
      const double dt = time - states_[last].time;
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
    const bool slower = speed >= kSlow && states_[k].velocity.norm() < speed / 2;
    if (misses == 0 && slower &&
        (found.position - states_[k].position).head<2>().norm() > kMaxDrift) {
      const Registration there = registered(pose_of(k));
      if (there.share > found.share) {
        found = there;
        motion.start({time, found.position, found.covariance}, states_[k].velocity,
                     kShiftSpeedDeviation);
      }
    }
    measured.set(k, found, {time, {}, {}, turn.position().x(), 0});
    MeasuredPosition& position = measured.positions[k];
    if (is_known(track_.observations[k].ground)) separate_height(position.covariance);
    if (!motion.expects(position)) position.covariance *= kOutlierFactor;
    motion.update(position), turn.update(measured.headings[k]);
    if (misses > 0) continue;
    last = k, T_last = found.T_world_object;
    if (found.share >= kMinRegisteredShare) model.add(seen, found.T_world_object);
  }
  return step > 0 ? states_.size() : std::size_t(-1);
}

/// What a registration measured. Headings go on from that of the state, so that they do not jump by
/// a turn.
void TrackPath::Measurements::set(std::size_t k, const Registration& found, const State& state) {
  const double factor = found.share >= kMinRegisteredShare ? 1 : kOutlierFactor;
  const double heading = state.heading + wrapped(found.heading - state.heading);
  positions[k] = {state.time, found.position, factor * found.covariance};
  headings[k] = {state.time,
                 {heading, 0, 0},
                 Eigen::Vector3d(factor * found.heading_variance, 1, 1).asDiagonal()};
}

/// The motion through measured positions and headings. Vertical sides tell nothing of the height,
/// the ground does.
void TrackPath::smooth(const Measurements& measured) {
  std::vector<MeasuredPosition> positions;
  for (std::size_t k = 0; k < states_.size(); ++k)
    positions.push_back(grounded(measured.positions[k], track_.observations[k].ground));
  const auto& headings = measured.headings;
  std::vector<Position> turn_changes;
  for (std::size_t k = 0; k < states_.size(); ++k) turn_changes.push_back(turn_change(k));
  const auto motions = smooth_positions(positions, {positions.size(), kChange});
  const auto turns = smooth_positions(headings, turn_changes);
  for (std::size_t k = 0; k < states_.size(); ++k) {
    states_[k].position = motions[k].position;
    states_[k].velocity = motions[k].velocity;
    states_[k].heading = turns[k].position.x();
    const double of_position = kSweepsAlike * motions[k].covariance.topLeftCorner<2, 2>().trace();
    const double of_ends = kHalfLength * kHalfLength * turns[k].covariance(0, 0);
    states_[k].deviation = std::sqrt(of_position + of_ends);
  }
}

/// How far each surface lies beside the model, where the path says that it is. What is not known
/// along a flat side, or of a heading where little was seen, does not count.
void TrackPath::measure_surfaces(const SurfaceModel& model, const ExpectedPose& near) {
  for (std::size_t k = 0; k < states_.size(); ++k) {
    states_[k].surface_deviation = states_[k].deviation;
    const SeenSurface seen = surface(k);
    const Pose T = pose_of(k);
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
    if (count > 0)
      states_[k].surface_deviation =
          std::sqrt((sum + kResidualDeviation * kResidualDeviation) / count);
  }
}

/// Around what several sweeps saw of the object.
void TrackPath::find_extent(const SurfaceModel& model) {
  std::vector<float> sides[3];
  const int least = std::min<int>(kMinHits, 1 + int(states_.size()) / kMinHits);
  for (std::size_t i = 0; i < model.hits().size(); ++i)
    for (int axis = 0; axis < 3 && model.hits()[i] >= least; ++axis)
      sides[axis].push_back(model.surface().points[i][axis]);
  for (int axis = 0; axis < 3 && !sides[0].empty(); ++axis) {
    extent_.low[axis] = quantile(sides[axis], 1 - kExtentQuantile);
    extent_.high[axis] = quantile(sides[axis], kExtentQuantile);
  }
}

/// As measured, not held: what a sweep shows of the object is looked for in these boxes.
void TrackPath::find_extents() {
  std::vector<float> sides[6];
  for (std::size_t k = 0; k < states_.size(); ++k) {
    extents_.push_back(extent_in(seen_[k].points, pose_of(k)));
    for (int axis = 0; axis < 3; ++axis) {
      sides[axis].push_back(extents_[k].low[axis]);
      sides[3 + axis].push_back(extents_[k].high[axis]);
    }
  }
  if (!rigid_ || !(extent_.size().minCoeff() > 0))
    for (int axis = 0; axis < 3; ++axis) {
      extent_.low[axis] = quantile(sides[axis], 1 - kRigidQuantile);
      extent_.high[axis] = quantile(sides[3 + axis], kRigidQuantile);
    }
}

/// What stands does not turn.
Position TrackPath::turn_change(std::size_t k) const {
  const double speed = std::max(states_[k].velocity.head<2>().norm(),
                                states_[k > 0 ? k - 1 : k].velocity.head<2>().norm());
  return Position::Constant(kTurnChange * std::clamp(speed / kMinHeadingSpeed, kStandingTurn, 1.0));
}

Pose TrackPath::pose_of(std::size_t k) const {
  return standing_pose(states_[k].position, states_[k].heading, states_[k].slope);
}

/// The observation after a time, but the second at least and the last at most.
std::size_t TrackPath::after(double t) const {
  const auto later = [](double time, const State& state) { return time < state.time; };
  const auto k = std::upper_bound(states_.begin(), states_.end(), t, later) - states_.begin();
  return std::clamp<std::size_t>(std::size_t(k), 1, std::max<std::size_t>(states_.size() - 1, 1));
}

Position TrackPath::velocity(double t) const {
  if (states_.size() == 1) return states_[0].velocity;
  const std::size_t k = after(t);
  const State &a = states_[k - 1], &b = states_[k];
  const double share = std::clamp((t - a.time) / (b.time - a.time), 0.0, 1.0);
  return (1 - share) * a.velocity + share * b.velocity;
}

Pose TrackPath::pose(double t) const {
  const State &first = states_.front(), &last = states_.back();
  if (t <= first.time || t >= last.time) {
    const State& end = t <= first.time ? first : last;
    return standing_pose(end.position + (t - end.time) * end.velocity, end.heading, end.slope);
  }
  const std::size_t k = after(t);
  const State &a = states_[k - 1], &b = states_[k];
  const double share = (t - a.time) / (b.time - a.time);
  const auto mix = [&](const auto& from, const auto& to) {
    return (1 - share) * from + share * to;
  };
  return standing_pose(mix(a.position, b.position), mix(a.heading, b.heading),
                       mix(a.slope, b.slope));
}

bool TrackPath::covers(double t) const {
  const double nearest = std::clamp(t, states_.front().time, states_.back().time);
  const double gap = speed(nearest) < kStanding ? p_.max_gap_standing : p_.max_gap;
  return std::fabs(t - nearest) <= gap + kTimeTolerance;
}

OrientedBox TrackPath::box(double t) const {
  const bool stands = speed(t) < kStanding;
  const double window = (stands ? kStandingWindowFactor * p_.window : p_.window) + kTimeTolerance;
  const std::size_t k = after(t);
  const auto distance = [&](std::size_t i) { return std::fabs(states_[i].time - t); };
  std::size_t nearest = k < states_.size() && distance(k) < distance(k - 1) ? k : k - 1;
  Extent around = extents_[nearest];
  Vector largest = around.size();
  for (int step : {-1, 1})
    for (std::size_t i = nearest + std::size_t(step); i < extents_.size() && distance(i) <= window;
         i += std::size_t(step)) {
      around.add(extents_[i]);
      largest = largest.cwiseMax(extents_[i].size());
    }
  if (!could_match(around, largest)) around = extents_[nearest];  // not all are the same object
  Pose T = pose(t);
  T.translate((0.5f * (around.low + around.high)).cast<double>());
  return {T.inverse().cast<float>(), 0.5f * around.size()};
}

float TrackPath::distance(bool dynamic) const {
  double most = 0;
  std::size_t first = states_.size();
  for (std::size_t k = 0; k < states_.size(); ++k) {
    if (dynamic && !track_.observations[k].dynamic) continue;
    if (first == states_.size()) first = k;
    const State &a = states_[first], &b = states_[k];
    const double unsure = kSureDeviations * std::hypot(a.deviation, b.deviation);
    most = std::max(most, (b.position - a.position).head<2>().norm() - unsure);
  }
  return float(most);
}

}  // namespace docdepth
