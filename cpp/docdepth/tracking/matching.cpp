#include "docdepth/tracking/matching.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "docdepth/geometry/point_grid.hpp"
#include "docdepth/tracking/constants.hpp"
#include "docdepth/tracking/neighbors.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// One object never looks larger than its size times the factor, plus the margin [m].
constexpr float kMaxSizeFactor = 1.5f;
constexpr float kMaxSizeMargin = 0.5f;

/// Share of the shifted samples that have one of `others` beside them. Rings leave gaps above and
/// below, so that only the horizontal distance tells exactly.
float level_share(const SampledPoints& samples, const Vector& shift, const PointGrid& others,
                  float distance) {
  std::size_t found = 0;
  for (const Vector& sample : samples) {
    const Vector p = sample + shift;
    found += others.any_near(p, distance, [&](const Vector& q, std::size_t) {
      return (q - p).head<2>().squaredNorm() < distance * distance &&
             std::fabs(q.z() - p.z()) < kMatchDistance;
    });
  }
  return float(found) / float(samples.size());
}

/// A track and a sweep in which it may go on.
class MatchSearch {
 public:
  MatchSearch(const TrackState& state, const DetectionIndex& seen,
              const std::function<bool(std::uint32_t)>& is_free, double time,
              const MatchOptions& options)
      : state_(state),
        index_(seen),
        seen_(seen.detections()),
        is_free_(is_free),
        time_(time),
        dt_(float(time - state.time)),
        reach_(options.max_speed * std::fabs(dt_)),
        options_(options),
        expected_(state.velocity.mean * dt_) {
    expected_.z() = state.grade.rise(time, {});
  }

  /// The best match of these samples of the track.
  Match best(const TimedPoints& samples) const {
    Match best;
    std::vector<Vector> tried;
    const auto attempt = [&](const Vector& start) {
      // No road is so steep: the ground was seen wrong.
      if (std::fabs(start.z()) > float(MotionFilter::kSteepest) * start.head<2>().norm()) return;
      const auto is_same = [&](const Vector& other) {
        return (other - start).norm() < kSampleSpacing;
      };
      if (std::any_of(tried.begin(), tried.end(), is_same)) return;
      tried.push_back(start);
      Match match = from(start, samples);
      if (match.score > best.score) best = std::move(match);
    };
    if (state_.velocity.is_known) {
      attempt(expected_);
      attempt(Vector::Zero());
    }
    const Extent box = extent_of(samples.points);
    const bool is_known = state_.velocity.is_known;
    const Extent around = is_known ? box.moved(expected_) : box;
    const float margin = is_known ? kSearchMargin : reach_;
    for (const auto k : index_.near(around, margin, state_.velocity.mean, state_.offset)) {
      const Detection& object = seen_[k];
      if (!could_match(object.box, state_.largest) || !(is_known || object.is_transient()) ||
          !box_of(object, state_.velocity.mean).overlaps(around, margin) || !is_free_(k))
        continue;
      const float rise = state_.grade.rise(time_, object.ground);
      try_shifts(samples, box, object, 0, attempt);  // in any case: the ground may be seen wrong
      if (rise != 0) try_shifts(samples, box, object, rise, attempt);
    }
    return best;
  }

 private:
  /// How wrong a shift of what is so far away may be [m].
  float shift_error_at(float range) const {
    return std::max(options_.shift_error, options_.ray_spacing * range);
  }
  SampledPoints samples_of(const Detection& object, const Vector& velocity) const {
    return at_time(object.samples(), object.surface.times, velocity, state_.offset);
  }
  Extent box_of(const Detection& object, const Vector& velocity) const {
    return object.box.moved((state_.offset - object.time_offset) * velocity);
  }

  /// Shifts to a detection after a rise. Along a flat side every shift fits; its ends tell how far
  /// it went.
  template <class Attempt>
  void try_shifts(const TimedPoints& samples, const Extent& box, const Detection& object,
                  float rise, const Attempt& attempt) const {
    const Extent there = box_of(object, state_.velocity.mean);
    const float share = 1 + (object.time_offset - state_.offset) / dt_;
    for (Vector shift : {Vector(there.low - box.low), Vector(there.high - box.high)}) {
      if (!state_.velocity.is_known) shift /= std::max(share, kMinTimeShare);
      if (shift.head<2>().norm() <= reach_) attempt({shift.x(), shift.y(), rise});
    }
    if (!state_.velocity.is_known)
      attempt(most_frequent_shift(samples, {object.samples(), object.surface.times}, dt_, reach_,
                                  rise));
  }

  /// The detections onto which the samples fall, with a shift that is refined from `start`.
  Match from(const Vector& start, const TimedPoints& of_track) const {
    const bool can_be = state_.velocity.allows(start, dt_, shift_error_at(0));
    const Vector velocity = can_be ? Vector(start / dt_) : state_.velocity.mean;
    const SampledPoints samples = at_time(of_track.points, of_track.times, velocity, state_.offset);
    const Extent box = extent_of(samples).moved(start);
    std::vector<std::uint32_t> near;
    std::vector<SampledPoints> samples_near;
    float range = 0;
    SampledPoints there;
    for (const auto k : index_.near(box, kSearchMargin, velocity, state_.offset)) {
      const Detection& object = seen_[k];
      if (!box_of(object, velocity).overlaps(box, kSearchMargin) || !is_free_(k)) continue;
      if (!state_.velocity.is_known && !object.is_transient()) continue;
      if (!could_match(object.box, state_.largest) || is_among(object, state_.neighbors)) continue;
      near.push_back(k);
      range = std::max(range, object.range());
      samples_near.push_back(samples_of(object, velocity));
      append(there, samples_near.back());
    }
    Match match;
    match.shift = start;
    match.largest = state_.largest;
    if (!refine_shift(samples, there, match.shift)) return {};
    match.error = shift_error_at(range);
    if (!state_.velocity.allows(match.shift, dt_, match.error)) match.shift = start;
    if (!state_.velocity.allows(match.shift, dt_, match.error)) return {};
    const PointGrid track(samples);
    for (std::size_t n = 0; n < near.size(); ++n)
      if (matched_share(samples_near[n], -match.shift, track) >= kMinMemberShare)
        match.detections.push_back(near[n]);
    if (match.detections.empty()) return {};
    match.neighbors = drop_neighbors(seen_, match.detections);
    match.box = seen_[match.detections[0]].box;
    SampledPoints found;
    for (const auto k : match.detections)
      add(seen_[k], samples_of(seen_[k], velocity), match, found);
    const PointGrid kept(found);
    // Together larger than one object: a pedestrian and what he walks away from.
    if (!could_match(match.box, match.largest)) return {};
    // Half of a track may be hidden, so twice its matched share counts. Of two equal matches the
    // one nearer to where it is expected is more likely.
    const auto score = [&](const auto& share) {
      return std::min(1.0f, 2 * share(samples, match.shift, kept)) *
             share(found, -match.shift, track) /
             (1 + (match.shift - expected_).norm() / (2 * reach_));
    };
    const auto nearly = [](const auto&... of) { return matched_share(of...); };
    const float share = score(nearly);
    if (share < options_.min_share) return {};
    const auto exactly = [&](const auto&... of) {
      return level_share(of..., options_.level_distance);
    };
    const float exact = score(exactly);
    match.score = exact + options_.near_weight * share;
    return match;
  }

  static void add(const Detection& object, const SampledPoints& samples, Match& match,
                  SampledPoints& found) {
    append(match.samples, object);
    append(found, samples);
    match.hidden |= !object.hidden.points.empty();
    match.box.add(object.box);
    match.largest = match.largest.cwiseMax(object.box.size());
  }

  const TrackState& state_;
  const DetectionIndex& index_;
  const Detections& seen_;
  const std::function<bool(std::uint32_t)>& is_free_;
  const double time_;
  const float dt_, reach_;
  const MatchOptions options_;
  Vector expected_;
};

}  // namespace

Match find_match(const TrackState& state, const DetectionIndex& seen,
                 const std::function<bool(std::uint32_t)>& is_free, double time,
                 const MatchOptions& options) {
  const MatchSearch search(state, seen, is_free, time, options);
  Match match = search.best(state.samples);
  return match.score > 0 ? match : search.best(state.last);
}

bool could_match(const Extent& box, const Vector& size) {
  const Vector most = size * kMaxSizeFactor + Vector::Constant(kMaxSizeMargin);
  return (box.size().array() < most.array()).all();
}

}  // namespace docdepth
