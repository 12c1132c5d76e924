#include "docdepth/tracking/matching.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "docdepth/detections/constants.hpp"
#include "docdepth/tracking/neighbors.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// Share of the shifted samples that have one of `others` beside them. Rings leave gaps above and
/// below, so that only the horizontal distance tells exactly.
float level_share(const SampledPoints& samples, const Vector& shift, const SampledPoints& others) {
  std::size_t found = 0;
  for (const Vector& sample : samples) {
    const Vector p = sample + shift;
    found += std::any_of(others.begin(), others.end(), [&](const Vector& q) {
      return (q - p).head<2>().squaredNorm() < kLevelDistance * kLevelDistance &&
             std::fabs(q.z() - p.z()) < kMatchDistance;
    });
  }
  return float(found) / float(samples.size());
}

/// A track and a sweep in which it may go on.
class Search {
 public:
  Search(const TrackEnd& end, const Detections& seen, const std::vector<bool>& free, double time,
         float max_speed)
      : end_(end),
        seen_(seen),
        free_(free),
        time_(time),
        dt_(float(time - end.time)),
        reach_(max_speed * std::fabs(dt_)),
        expected_(end.speed.velocity * dt_) {
    expected_.z() = end.elevation.rise(time, {});
  }

  /// The best match of these samples of the track.
  Match best(const TimedPoints& samples) const {
    Match best;
    std::vector<Vector> tried;
    const auto attempt = [&](const Vector& start) {
      // No road is so steep: the ground was seen wrong.
      if (std::fabs(start.z()) > float(kSteepest) * start.head<2>().norm()) return;
      const auto is_same = [&](const Vector& other) {
        return (other - start).norm() < kSampleSpacing;
      };
      if (std::any_of(tried.begin(), tried.end(), is_same)) return;
      tried.push_back(start);
      Match match = from(start, samples);
      if (match.score > best.score) best = std::move(match);
    };
    if (end_.speed.is_known) {
      attempt(expected_);
      attempt(Vector::Zero());
    }
    const Extent box = extent_of(samples.points);
    for (std::uint32_t k = 0; k < seen_.size(); ++k) {
      const Detection& object = seen_[k];
      if (!free_[k] || !could_match(object.box, end_.largest)) continue;
      const Extent there = box_of(object, end_.speed.velocity);
      const bool near = end_.speed.is_known ? there.overlaps(box.moved(expected_), kSearchMargin)
                                            : object.is_passing() && there.overlaps(box, reach_);
      if (!near) continue;
      const float rise = end_.elevation.rise(time_, object.ground);
      try_shifts(samples, box, object, 0, attempt);  // in any case: the ground may be seen wrong
      if (rise != 0) try_shifts(samples, box, object, rise, attempt);
    }
    return best;
  }

 private:
  SampledPoints samples_of(const Detection& object, const Vector& velocity) const {
    return held(object.samples(), object.surface.times, velocity, end_.offset);
  }
  Extent box_of(const Detection& object, const Vector& velocity) const {
    return object.box.moved((end_.offset - object.time_offset) * velocity);
  }

  /// Shifts to a detection after a rise. Along a flat side every shift fits; its ends tell how far
  /// it went.
  template <class Attempt>
  void try_shifts(const TimedPoints& samples, const Extent& box, const Detection& object,
                  float rise, const Attempt& attempt) const {
    const Extent there = box_of(object, end_.speed.velocity);
    const float share = 1 + (object.time_offset - end_.offset) / dt_;
    for (Vector shift : {Vector(there.low - box.low), Vector(there.high - box.high)}) {
      if (!end_.speed.is_known) shift /= std::max(share, kMinTimeShare);
      if (shift.head<2>().norm() <= reach_) attempt({shift.x(), shift.y(), rise});
    }
    if (!end_.speed.is_known)
      attempt(most_frequent_shift(samples, {object.samples(), object.surface.times}, dt_, reach_,
                                  rise));
  }

  /// The detections onto which the samples fall, with a shift that is refined from `start`.
  Match from(const Vector& start, const TimedPoints& of_track) const {
    const bool can_be = end_.speed.allows(start, dt_, shift_error_at(0));
    const Vector velocity = can_be ? Vector(start / dt_) : end_.speed.velocity;
    const SampledPoints samples = held(of_track.points, of_track.times, velocity, end_.offset);
    const Extent box = extent_of(samples).moved(start);
    std::vector<std::uint32_t> near;
    std::vector<SampledPoints> samples_near;
    float range = 0;
    SampledPoints there;
    for (std::uint32_t k = 0; k < seen_.size(); ++k) {
      const Detection& object = seen_[k];
      if (!box_of(object, velocity).overlaps(box, kSearchMargin) || !free_[k]) continue;
      if (!end_.speed.is_known && !object.is_passing()) continue;
      if (!could_match(object.box, end_.largest) || is_among(object, end_.neighbors)) continue;
      near.push_back(k);
      range = std::max(range, object.range());
      samples_near.push_back(samples_of(object, velocity));
      append(there, samples_near.back());
    }
    Match match;
    match.shift = start;
    match.largest = end_.largest;
    if (!refine_shift(samples, there, match.shift)) return {};
    match.error = shift_error_at(range);
    if (!end_.speed.allows(match.shift, dt_, match.error)) match.shift = start;
    if (!end_.speed.allows(match.shift, dt_, match.error)) return {};
    for (std::size_t n = 0; n < near.size(); ++n)
      if (matched_share(samples_near[n], -match.shift, samples) >= kMinMemberShare)
        match.objects.push_back(near[n]);
    if (match.objects.empty()) return {};
    match.neighbors = drop_neighbors(seen_, match.objects);
    match.box = seen_[match.objects[0]].box;
    SampledPoints found;
    for (const auto k : match.objects) add(seen_[k], samples_of(seen_[k], velocity), match, found);
    // Where most of the track is not what was kept, what was dropped may be the track itself.
    if (matched_share(samples, match.shift, found) < kMinKeptShare) match.neighbors.clear();
    // Together larger than one object: a pedestrian and what he walks away from.
    if (!could_match(match.box, match.largest)) return {};
    // Half of a track may be hidden, so twice its matched share counts. Of two equal matches the
    // one nearer to where it is expected is more likely.
    const auto score = [&](const auto& share) {
      return std::min(1.0f, 2 * share(samples, match.shift, found)) *
             share(found, -match.shift, samples) /
             (1 + (match.shift - expected_).norm() / (2 * reach_));
    };
    const auto nearly = [](const auto&... of) { return matched_share(of...); };
    const float share = score(nearly);
    if (share < kMinMatchedShare) return {};
    const float exact = score(level_share);
    match.score = exact + kNearWeight * share;
    // Two petals of a rosette see two parts of a car: the less they have in common, the less they
    // tell how far it went.
    if (!end_.speed.is_known)
      match.error = std::max(match.error, kFirstShiftError * (1 - exact) * match.shift.norm());
    return match;
  }

  static void add(const Detection& object, const SampledPoints& samples, Match& match,
                  SampledPoints& found) {
    append(match.samples, object);
    append(found, samples);
    match.hidden |= !object.hidden.points.empty();
    match.area += object.area;
    match.box.add(object.box);
    match.largest = match.largest.cwiseMax(object.box.size());
  }

  const TrackEnd& end_;
  const Detections& seen_;
  const std::vector<bool>& free_;
  const double time_;
  const float dt_, reach_;
  Vector expected_;
};

}  // namespace

Match find_match(const TrackEnd& end, const Detections& seen, const std::vector<bool>& free,
                 double time, float max_speed) {
  const Search search(end, seen, free, time, max_speed);
  Match match = search.best(end.samples);
  return match.score > 0 ? match : search.best(end.last);
}

bool could_match(const Extent& box, const Vector& size) {
  const Vector most = size * kMaxSizeFactor + Vector::Constant(kMaxSizeMargin);
  return (box.size().array() < most.array()).all();
}

}  // namespace docdepth
