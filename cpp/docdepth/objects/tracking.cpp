#include "docdepth/objects/tracking.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/objects/constants.hpp"
#include "docdepth/objects/dynamic_voxels.hpp"
#include "docdepth/objects/track_motion.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Flags = std::vector<std::uint8_t>;

struct Track {
  SampledPoints samples;  ///< of the last two observations: each may see another part
  SampledPoints last;     ///< of the last observation
  Vector largest;         ///< size of its objects
  double time;
  std::vector<TrackObservation> observations;
  Vector velocity = Vector::Zero();
  int dynamic = 1;               ///< observations that are dynamic by their votes
  std::size_t last_dynamic = 0;  ///< the last of them

  bool has_velocity() const { return observations.size() > 1; }
};

/// The continuation of a track in a sweep.
struct Match {
  float score = 0;
  Vector shift = Vector::Zero();
  std::vector<std::uint32_t> objects;
  SampledPoints samples;
  Extent box;
  Vector largest;
};

bool can_be_tracked(const Detection& object) {
  return object.box.size().z() >= kMinTrackedHeight && object.box.width() <= kMaxObjectWidth;
}

void append(SampledPoints& samples, const SampledPoints& more) {
  samples.insert(samples.end(), more.begin(), more.end());
}

/// Tracks objects from sweep to sweep, forward or backward in time.
class Tracker {
 public:
  Tracker(const std::vector<const Detections*>& detections, const std::vector<double>& times,
          const TrackParameters& p)
      : detections_(detections), times_(times), p_(p) {}

  std::vector<Track> run(bool backward) {
    const std::size_t count = detections_.size();
    for (std::size_t k = 0; k < count; ++k) advance(backward ? count - 1 - k : k);
    for (Track& track : alive_) done_.push_back(std::move(track));
    return std::move(done_);
  }

 private:
  void advance(std::size_t sweep) {
    const Detections& seen = *detections_[sweep];
    Flags taken(seen.size());
    for (std::size_t k = 0; k < seen.size(); ++k) taken[k] = !can_be_tracked(seen[k]);
    // The longest track chooses first.
    std::stable_sort(alive_.begin(), alive_.end(), [](const Track& a, const Track& b) {
      return a.observations.size() > b.observations.size();
    });
    std::vector<Track> alive;
    for (Track& track : alive_) {
      const double dt = times_[sweep] - track.time;
      Match match = find(track, track.samples, seen, taken, dt);
      if (match.score == 0) match = find(track, track.last, seen, taken, dt);
      if (match.score > 0) add(track, sweep, std::move(match), taken);
      auto& to = std::fabs(times_[sweep] - track.time) <= max_gap(track) ? alive : done_;
      to.push_back(std::move(track));
    }
    alive_ = std::move(alive);
    for (std::uint32_t k = 0; k < seen.size(); ++k) {
      const auto& [first, points, dynamic, box, samples] = seen[k];
      if (!taken[k] && seen[k].is_dynamic() && samples.size() >= kMinSamples)
        alive_.push_back(
            {samples, samples, box.size(), times_[sweep], {{sweep, {k}, box, dynamic}}});
    }
  }

  double max_gap(const Track& track) const {
    const bool stands = track.has_velocity() && track.velocity.norm() < kStanding;
    return (stands && track.dynamic >= p_.min_detections ? p_.max_gap_standing : p_.max_gap) +
           kTimeTolerance;
  }

  /// The best match of these samples of a track.
  Match find(const Track& track, const SampledPoints& samples, const Detections& seen,
             const Flags& taken, double dt) const {
    const float reach = p_.max_speed * static_cast<float>(std::fabs(dt));
    Match best;
    const auto attempt = [&](const Vector& start) {
      Match match = match_from(track, samples, seen, taken, start, reach);
      if (match.score > best.score) best = std::move(match);
    };
    if (track.has_velocity()) {
      attempt(track.velocity * static_cast<float>(dt));
      attempt(Vector::Zero());
      return best;
    }
    const Extent box = extent_of(samples);
    for (std::size_t k = 0; k < seen.size(); ++k)
      if (!taken[k] && seen[k].is_dynamic() && seen[k].box.overlaps(box, reach))
        attempt(most_frequent_shift(samples, seen[k].samples, reach));
    return best;
  }

  /// The detections onto which the samples fall, with a shift that is refined from `start`.
  Match match_from(const Track& track, const SampledPoints& samples, const Detections& seen,
                   const Flags& taken, const Vector& start, float reach) const {
    Extent box = extent_of(samples);
    const Vector size = box.size();
    box.low += start;
    box.high += start;
    std::vector<std::uint32_t> near;
    SampledPoints there;
    for (std::uint32_t k = 0; k < seen.size(); ++k) {
      if (taken[k] || !seen[k].box.overlaps(box, kSearchMargin)) continue;
      if (!track.has_velocity() && !seen[k].is_dynamic()) continue;
      if (!could_match(seen[k].box, size)) continue;
      near.push_back(k);
      append(there, seen[k].samples);
    }
    Match match;
    match.shift = start;
    match.largest = track.largest;
    if (!refine_shift(samples, there, match.shift)) return {};
    for (const auto k : near) {
      if (matched_share(seen[k].samples, -match.shift, samples) < kMinMemberShare) continue;
      if (match.objects.empty()) match.box = seen[k].box;
      match.objects.push_back(k);
      append(match.samples, seen[k].samples);
      match.box.add(seen[k].box);
      match.largest = match.largest.cwiseMax(seen[k].box.size());
    }
    // Together larger than one object: a pedestrian and what he walks away from.
    if (match.objects.empty() || !could_match(match.box, match.largest)) return {};
    // Half of a track may be hidden, so twice its matched share counts.
    const float track_share =
                    std::min(1.0f, 2 * matched_share(samples, match.shift, match.samples)),
                match_share = matched_share(match.samples, -match.shift, samples);
    // Of two equal matches the nearer one is more likely.
    match.score = track_share * match_share / (1 + match.shift.norm() / (2 * reach));
    return match.score >= kMinMatchedShare ? match : Match{};
  }

  void add(Track& track, std::size_t sweep, Match&& match, Flags& taken) const {
    const Detections& seen = *detections_[sweep];
    const Vector velocity = match.shift / static_cast<float>(times_[sweep] - track.time);
    track.velocity = track.has_velocity() ? 0.5f * track.velocity + 0.5f * velocity : velocity;
    track.time = times_[sweep];
    std::uint32_t points = 0, of_dynamic = 0, dynamic_points = 0;
    for (const auto k : match.objects) {
      taken[k] = 1;
      points += seen[k].points;
      dynamic_points += seen[k].dynamic;
      if (seen[k].is_dynamic()) of_dynamic += seen[k].points;
    }
    const bool is_dynamic = 2 * of_dynamic >= points;
    track.dynamic += is_dynamic;
    if (is_dynamic) track.last_dynamic = track.observations.size();
    SampledPoints both = std::move(track.last);
    for (Vector& p : both) p += match.shift;
    append(both, match.samples);
    track.samples = downsample(both, kSampleSpacing, kMaxSamples);
    track.last = std::move(match.samples);
    track.largest = match.largest;
    track.observations.push_back({sweep, std::move(match.objects), match.box, dynamic_points});
  }

  const std::vector<const Detections*>& detections_;
  const std::vector<double>& times_;
  const TrackParameters& p_;
  std::vector<Track> alive_, done_;
};

bool is_dynamic(const Track& track, const TrackParameters& p) {
  const auto& seen = track.observations;
  const auto distance_to = [&](const TrackObservation& to) {
    return (to.center() - seen.front().center()).norm();
  };
  return track.dynamic >= p.min_detections && distance_to(seen.back()) >= p.min_distance &&
         distance_to(seen[track.last_dynamic]) >= kMinVotedDistanceShare * p.min_distance;
}

/// Whether an object lies in the box, and not flat on the ground below it.
bool lies_inside(const Detection& object, const Extent& box) {
  return (object.box.low.array() >= box.low.array() - kSearchMargin).all() &&
         (object.box.high.array() <= box.high.array() + kSearchMargin).all() &&
         object.box.high.z() >= box.low.z() + kMinTrackedHeight;
}

/// Add a track to the result of a sweep.
void add_track(const TrackMotion& motion, std::size_t sweep, double time,
               const std::vector<const Detections*>& detections, const TrackParameters& p,
               TrackingResult& result) {
  const Extent box = motion.box(time);
  const float speed = motion.speed(time);
  const Detections& seen = *detections[sweep];
  for (std::uint32_t k = 0; k < seen.size(); ++k) {
    const bool there = p.window > 0 && speed < kSlow && lies_inside(seen[k], box);
    if (seen[k].dynamic < seen[k].points && seen[k].box.width() >= kMinTrackedWidth &&
        motion.can_support(seen[k]) && (there || motion.contains(sweep, k)) &&
        motion.was_free(seen[k].samples, sweep, detections))
      result.objects.push_back(seen[k].first);
  }
  if (p.window > 0 && speed >= kStanding) result.boxes.push_back(box);
}

}  // namespace

std::vector<TrackingResult> track_objects(const std::vector<const Detections*>& detections,
                                          const std::vector<double>& times,
                                          const TrackParameters& p, int threads) {
  std::vector<TrackingResult> directions[2];
  parallel_for(2, 1, threads, [&](std::size_t backward, std::size_t) {
    auto& results = directions[backward];
    results.resize(times.size());
    for (const Track& track : Tracker(detections, times, p).run(backward != 0)) {
      if (!is_dynamic(track, p)) continue;
      const TrackMotion motion(track.observations, times, p);
      for (std::size_t i = 0; i < times.size(); ++i)
        if (motion.covers(times[i])) add_track(motion, i, times[i], detections, p, results[i]);
    }
  });
  std::vector<TrackingResult> result = std::move(directions[0]);
  for (std::size_t i = 0; i < result.size(); ++i) {
    const TrackingResult& backward = directions[1][i];
    auto& rows = result[i].objects;
    rows.insert(rows.end(), backward.objects.begin(), backward.objects.end());
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
    auto& boxes = result[i].boxes;
    boxes.insert(boxes.end(), backward.boxes.begin(), backward.boxes.end());
  }
  auto voxels = dynamic_voxels(detections, times, result, p.window, threads);
  for (std::size_t i = 0; i < result.size(); ++i) result[i].voxels = std::move(voxels[i]);
  return result;
}

}  // namespace docdepth
