#include "docdepth/paths/shifted_path.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "docdepth/detections/quantile.hpp"
#include "docdepth/tracking/constants.hpp"
#include "docdepth/tracking/motion_filter.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Position = Eigen::Vector3d;

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

/// A pedestrian who touches a parked car is one object with it for some sweeps: little of that is
/// transient.
void find_widths(const std::vector<TrackObservation>& observations, const PathOptions& options,
                 Path& path) {
  const auto are_wide = [&](const std::vector<float>& widths) {
    return widths.size() > 2 && quantile(widths, options.rigid_quantile) >= kMinRigidWidth;
  };
  std::vector<float> widths, transient;
  for (const TrackObservation& seen : observations) {
    widths.push_back(seen.box.width());
    if (seen.is_mostly_transient()) transient.push_back(seen.box.width());
  }
  path.wide_while_transient = transient.size() <= 2 || are_wide(transient);
  path.rigid = are_wide(2 * transient.size() >= widths.size() ? transient : widths);
}

/// Sum the horizontal shifts from sweep to sweep. Heights are those of the ground, or of the lowest
/// points where no ground was seen.
void measure_shifts(const std::vector<TrackObservation>& observations,
                    const std::vector<double>& times, const PathOptions& options, Path& path) {
  std::vector<MeasuredPosition> measured;
  Position at = Position::Zero();
  path.has_ground =
      std::any_of(observations.begin(), observations.end(),
                  [](const TrackObservation& seen) { return seen.ground.is_known(); });
  const float unsure = float(path.has_ground ? options.hidden_deviation : options.height_deviation);
  for (int k = 0; k < int(observations.size()); ++k) {
    const TrackObservation& seen = observations[k];
    const GroundHeight height =
        seen.ground.is_known() ? seen.ground : GroundHeight{seen.box.low.z(), unsure};
    const Eigen::Vector3d deviation(options.shift_deviation, options.shift_deviation,
                                    height.deviation);
    const double time = times[observations[k].sweep] + seen.time_offset;
    if (k == 0)
      at = (0.5f * (seen.box.low + seen.box.high)).cast<double>();
    else
      at += (time - measured.back().time) /
            (times[observations[k].sweep] - times[observations[k - 1].sweep]) *
            seen.shift.cast<double>();
    measured.push_back({time,
                        {at.x(), at.y(), height.value},
                        Eigen::Vector3d(deviation.cwiseAbs2()).asDiagonal()});
  }
  const auto motions = smooth_positions(measured, {measured.size(), acceleration_change(options)});
  const double middle = 0.5 * double(measured.size() - 1);
  for (int k = 0; k < int(observations.size()); ++k) {
    const double drift = options.shift_drift * options.shift_drift * std::fabs(double(k) - middle);
    const double spread = motions[k].covariance.topLeftCorner<2, 2>().trace() + drift;
    path.states.push_back({.time = measured[k].time,
                           .position = motions[k].position,
                           .velocity = motions[k].velocity,
                           .is_transient = observations[k].is_transient,
                           .independent_deviation = std::sqrt(spread),
                           .deviation = std::sqrt(spread),
                           .surface_deviation = std::sqrt(spread)});
  }
}

/// Along the motion where it moves; where it stands, as it comes or goes.
std::vector<MotionHeading> find_headings(const SampledPoints& first, const PathOptions& options,
                                         Path& path) {
  const double least = path.rigid ? options.min_heading_speed : options.min_heading_speed / 2;
  const int count = int(path.states.size());
  std::vector<MotionHeading> headings(path.states.size());
  std::vector<int> moving;
  for (int k = 0; k < count; ++k)
    if (path.states[k].velocity.head<2>().norm() >= least) moving.push_back(k);
  if (moving.empty()) {
    const double heading = longest_direction(first);
    for (PathState& state : path.states) state.heading = heading;
    return headings;
  }
  for (const int k : moving) {
    const Position& v = path.states[k].velocity;
    path.states[k].heading = std::atan2(v.y(), v.x());
    const double deviation =
        std::hypot(options.motion_heading_deviation, options.creep / v.head<2>().norm());
    headings[k] = {path.states[k].heading, deviation * deviation};
    if (path.rigid)  // people are upright uphill, too
      path.states[k].slope = std::clamp(std::atan2(v.z(), v.head<2>().norm()),
                                        -MotionFilter::kSteepest, MotionFilter::kSteepest);
  }
  std::size_t next = 0;
  for (int k = 0; k < count; ++k) {
    while (next + 1 < moving.size() && moving[next] < k) ++next;
    int nearest = moving[next];
    if (next > 0 && k - moving[next - 1] < std::abs(nearest - k)) nearest = moving[next - 1];
    path.states[k].heading = path.states[nearest].heading;
    path.states[k].slope = path.states[nearest].slope;
  }
  for (int k = 1; k < count; ++k)
    path.states[k].heading =
        path.states[k - 1].heading + wrapped(path.states[k].heading - path.states[k - 1].heading);
  return headings;
}

}  // namespace

ShiftedPath path_by_shifts(const Track& track, std::span<const ObservedSurface> surfaces,
                           const std::vector<double>& times, const PathOptions& options) {
  ShiftedPath found;
  find_widths(track.observations, options, found.path);
  measure_shifts(track.observations, times, options, found.path);
  found.headings = find_headings(surfaces[0].points, options, found.path);
  return found;
}

Eigen::Vector3d acceleration_change(const PathOptions& options) {
  return {options.horizontal_change, options.horizontal_change, MotionFilter::kVerticalChange};
}

}  // namespace docdepth
