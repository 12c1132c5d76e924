#include "docdepth/objects/track_motion.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/objects/constants.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// Samples outside of a box, seen from above.
SampledPoints outside(const SampledPoints& samples, const Extent& box) {
  const Extent from_above{{box.low.x(), box.low.y(), -INFINITY},
                          {box.high.x(), box.high.y(), INFINITY}};
  SampledPoints result;
  for (const Vector& p : samples)
    if (!from_above.overlaps({p, p}, kOutsideMargin)) result.push_back(p);
  return result;
}

/// Number of samples at which a sweep saw a static object.
float occupied(const SampledPoints& samples, const Detections& detections) {
  const Extent box = extent_of(samples);
  SampledPoints there;
  for (const Detection& object : detections) {
    if (object.is_dynamic() || !object.box.overlaps(box, kOccupiedDistance)) continue;
    for (const Vector& p : object.samples)
      if (box.overlaps({p, p}, kOccupiedDistance)) there.push_back(p);
  }
  return matched_share(samples, Vector::Zero(), there, kOccupiedDistance) * float(samples.size());
}

}  // namespace

bool could_match(const Extent& box, const Vector& size) {
  const Vector most = size * kMaxSizeFactor + Vector::Constant(kMaxSizeMargin);
  return (box.size().array() < most.array()).all();
}

TrackMotion::TrackMotion(std::vector<TrackObservation> observations,
                         const std::vector<double>& times, const TrackParameters& p)
    : observations_(std::move(observations)), times_(times), p_(p) {
  if (observations_.front().sweep > observations_.back().sweep)
    std::reverse(observations_.begin(), observations_.end());
  std::size_t total = 0;
  for (const TrackObservation& seen : observations_) {
    const double t = times_[seen.sweep];
    boxes_.push_back(speed(t) < kStanding ? box(t) : seen.box);
    total += seen.dynamic_points;
    max_static_points_ =
        std::max({max_static_points_, seen.dynamic_points, total / kTotalSupportDivisor});
  }
}

bool TrackMotion::covers(double t) const {
  const double nearest = std::clamp(t, time(0), time(observations_.size() - 1));
  const double gap = speed(nearest) < kStanding ? p_.max_gap_standing : p_.max_gap;
  return std::fabs(t - nearest) <= gap + kTimeTolerance;
}

Extent TrackMotion::box(double t) const {
  const bool stands = speed(t) < kStanding;
  const Vector v = stands ? Vector::Zero() : velocity(t);
  const double window = (stands ? kStandingWindowFactor * p_.window : p_.window) + kTimeTolerance;
  const auto distance = [&](std::size_t k) { return std::fabs(time(k) - t); };
  const auto moved = [&](std::size_t k) {
    const Vector shift = v * float(t - time(k));
    return Extent{observations_[k].box.low + shift, observations_[k].box.high + shift};
  };
  std::size_t nearest = 0;
  for (std::size_t k = 1; k < observations_.size(); ++k)
    if (distance(k) < distance(nearest)) nearest = k;
  Extent box = moved(nearest);
  Vector largest = observations_[nearest].box.size();
  for (std::size_t k = 0; k < observations_.size(); ++k) {
    if (distance(k) > window) continue;
    box.add(moved(k));
    largest = largest.cwiseMax(observations_[k].box.size());
  }
  return could_match(box, largest) ? box : moved(nearest);  // not all are the same object
}

bool TrackMotion::contains(std::size_t sweep, std::uint32_t object) const {
  return std::any_of(observations_.begin(), observations_.end(), [&](const TrackObservation& seen) {
    return seen.sweep == sweep &&
           std::find(seen.objects.begin(), seen.objects.end(), object) != seen.objects.end();
  });
}

bool TrackMotion::was_free(const SampledPoints& samples, std::size_t sweep,
                           const std::vector<const Detections*>& detections) const {
  const auto distance = [&](std::size_t k) {
    const std::size_t other = observations_[k].sweep;
    return other > sweep ? other - sweep : sweep - other;
  };
  const auto left = [&](std::size_t k) { return outside(samples, boxes_[k]); };
  const auto count = float(samples.size());
  std::vector<std::size_t> elsewhere;
  for (std::size_t k = 0; k < observations_.size(); ++k)
    if (float(left(k).size()) >= kMinOutsideShare * count) elsewhere.push_back(k);
  std::stable_sort(elsewhere.begin(), elsewhere.end(),
                   [&](std::size_t a, std::size_t b) { return distance(a) < distance(b); });
  const std::size_t last = std::min(elsewhere.size(), kFreeTestStride * kMaxFreeTests);
  for (std::size_t i = 0; i < last; i += kFreeTestStride) {
    const std::size_t k = elsewhere[i];
    if (occupied(left(k), *detections[observations_[k].sweep]) >= kMinOccupiedShare * count)
      return false;
  }
  return !elsewhere.empty();
}

/// The mean over a few observations before and after, since each sweep sees other parts.
Vector TrackMotion::velocity(double t) const {
  const std::size_t count = observations_.size(), pairs = std::min(kVelocityPairs, count / 2);
  std::size_t k = 0;
  while (k < count && time(k) < t) ++k;
  k = std::clamp(k, pairs, count - pairs);
  Vector distance = Vector::Zero();
  double duration = 0;
  for (std::size_t i = 0; i < pairs; ++i) {
    distance += observations_[k + i].center() - observations_[k - 1 - i].center();
    duration += time(k + i) - time(k - 1 - i);
  }
  return distance / float(duration);
}

}  // namespace docdepth
