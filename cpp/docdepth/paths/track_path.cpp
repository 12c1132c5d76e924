#include "docdepth/paths/track_path.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "docdepth/tracking/constants.hpp"
#include "docdepth/tracking/matching.hpp"

namespace docdepth {
namespace {

/// The box of a standing object is collected over this many times the window.
constexpr double kStandingWindowFactor = 3;
/// An object has surely moved by what it moved less so many standard deviations.
constexpr double kSureDeviations = 2;

/// Distance from the first of some states that is surely reached.
class SureDistance {
 public:
  void add(const PathState& state) {
    if (!first_) first_ = state;
    // That it moves is told by votes, too. By these alone, few returns that arrive would be lost.
    const double unsure =
        kSureDeviations * std::hypot(first_->independent_deviation, state.independent_deviation);
    most_ = std::max(most_, (state.position - first_->position).head<2>().norm() - unsure);
  }
  float value() const { return float(most_); }

 private:
  std::optional<PathState> first_;
  double most_ = 0;
};

}  // namespace

TrackPath::TrackPath(Path path, const TrackingOptions& options)
    : path_(std::move(path)),
      window_(options.window),
      max_gap_(options.max_gap),
      max_gap_standing_(options.max_gap_standing) {}

/// The observation after a time, but the second at least and the last at most.
int TrackPath::after(double t) const {
  const auto later = [](double time, const PathState& state) { return time < state.time; };
  const auto k =
      std::upper_bound(path_.states.begin(), path_.states.end(), t, later) - path_.states.begin();
  return std::clamp(int(k), 1, std::max(count() - 1, 1));
}

Eigen::Vector3d TrackPath::velocity(double t) const {
  if (count() == 1) return path_.states[0].velocity;
  const int k = after(t);
  const PathState &a = path_.states[k - 1], &b = path_.states[k];
  const double share = std::clamp((t - a.time) / (b.time - a.time), 0.0, 1.0);
  return (1 - share) * a.velocity + share * b.velocity;
}

Pose TrackPath::pose(double t) const {
  const PathState &first = path_.states.front(), &last = path_.states.back();
  if (t <= first.time || t >= last.time) {
    const PathState& end = t <= first.time ? first : last;
    return upright_pose(end.position + (t - end.time) * end.velocity, end.heading, end.slope);
  }
  const int k = after(t);
  const PathState &a = path_.states[k - 1], &b = path_.states[k];
  const double share = (t - a.time) / (b.time - a.time);
  const auto mix = [&](const auto& from, const auto& to) {
    return (1 - share) * from + share * to;
  };
  return upright_pose(mix(a.position, b.position), mix(a.heading, b.heading),
                      mix(a.slope, b.slope));
}

bool TrackPath::covers(double t) const {
  const double nearest = std::clamp(t, path_.states.front().time, path_.states.back().time);
  const double gap = speed(nearest) < kStanding ? max_gap_standing_ : max_gap_;
  return std::fabs(t - nearest) <= gap + kTimeTolerance;
}

OrientedBox TrackPath::box(double t) const {
  const bool stands = speed(t) < kStanding;
  const double window = (stands ? kStandingWindowFactor * window_ : window_) + kTimeTolerance;
  const auto distance = [&](int i) { return std::fabs(path_.states[i].time - t); };
  const int k = after(t);
  const int nearest = k < count() && distance(k) < distance(k - 1) ? k : k - 1;
  Extent seen = path_.extents[nearest];
  Eigen::Vector3f largest = seen.size();
  for (const int step : {-1, 1})
    for (int i = nearest + step; i >= 0 && i < count() && distance(i) <= window; i += step) {
      seen.add(path_.extents[i]);
      largest = largest.cwiseMax(path_.extents[i].size());
    }
  if (!could_match(seen, largest)) seen = path_.extents[nearest];  // not all are the same object
  return around(seen, t);
}

OrientedBox TrackPath::around(const Extent& extent, double t) const {
  Pose T = pose(t);
  T.translate((0.5f * (extent.low + extent.high)).cast<double>());
  return {T.inverse().cast<float>(), 0.5f * extent.size()};
}

Extent TrackPath::reach() const {
  std::vector<Eigen::Vector3f> places;
  for (const PathState& state : path_.states) places.push_back(state.position.cast<float>());
  const double gap = std::max(max_gap_, max_gap_standing_) + kTimeTolerance;
  for (const double time : {path_.states.front().time - gap, path_.states.back().time + gap})
    places.push_back(pose(time).translation().cast<float>());
  const Extent around = extent_of(places);
  // From its place to the middle of its box, and twice from there to a corner.
  const Eigen::Vector3f middle = 0.5f * (path_.extent.low + path_.extent.high);
  const float radius = middle.norm() + path_.extent.size().norm();
  const Eigen::Vector3f low = around.low.array() - radius, high = around.high.array() + radius;
  return {{low.x(), low.y(), 0}, {high.x(), high.y(), 0}};
}

float TrackPath::distance() const {
  SureDistance distance;
  for (const PathState& state : path_.states) distance.add(state);
  return distance.value();
}

float TrackPath::transient_distance() const {
  SureDistance distance;
  for (const PathState& state : path_.states)
    if (state.is_transient) distance.add(state);
  return distance.value();
}

}  // namespace docdepth
