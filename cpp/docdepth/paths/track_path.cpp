#include "docdepth/paths/track_path.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/detections/constants.hpp"
#include "docdepth/tracking/matching.hpp"

namespace docdepth {

/// The observation after a time, but the second at least and the last at most.
std::size_t TrackPath::after(double t) const {
  const auto later = [](double time, const PathState& state) { return time < state.time; };
  const auto k =
      std::upper_bound(path_.states.begin(), path_.states.end(), t, later) - path_.states.begin();
  return std::clamp<std::size_t>(std::size_t(k), 1,
                                 std::max<std::size_t>(path_.states.size() - 1, 1));
}

Eigen::Vector3d TrackPath::velocity(double t) const {
  if (path_.states.size() == 1) return path_.states[0].velocity;
  const std::size_t k = after(t);
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
  const std::size_t k = after(t);
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
  const double gap = speed(nearest) < kStanding ? p_.max_gap_standing : p_.max_gap;
  return std::fabs(t - nearest) <= gap + kTimeTolerance;
}

OrientedBox TrackPath::box(double t) const {
  const bool stands = speed(t) < kStanding;
  const double window = (stands ? kStandingWindowFactor * p_.window : p_.window) + kTimeTolerance;
  const std::size_t k = after(t);
  const auto distance = [&](std::size_t i) { return std::fabs(path_.states[i].time - t); };
  std::size_t nearest = k < path_.states.size() && distance(k) < distance(k - 1) ? k : k - 1;
  Extent seen = path_.extents[nearest];
  Eigen::Vector3f largest = seen.size();
  for (int step : {-1, 1})
    for (std::size_t i = nearest + std::size_t(step);
         i < path_.extents.size() && distance(i) <= window; i += std::size_t(step)) {
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

float TrackPath::distance(bool dynamic) const {
  double most = 0;
  std::size_t first = path_.states.size();
  for (std::size_t k = 0; k < path_.states.size(); ++k) {
    if (dynamic && !track_.observations[k].dynamic) continue;
    if (first == path_.states.size()) first = k;
    const PathState &a = path_.states[first], &b = path_.states[k];
    // That it moves is told by votes, too. By these alone, few returns that arrive would be lost.
    const double unsure = kSureDeviations * std::hypot(a.least_deviation, b.least_deviation);
    most = std::max(most, (b.position - a.position).head<2>().norm() - unsure);
  }
  return float(most);
}

}  // namespace docdepth
