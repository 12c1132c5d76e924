#include "docdepth/tracking/tracker.hpp"

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

#include "docdepth/tracking/constants.hpp"
#include "docdepth/tracking/ego_body.hpp"
#include "docdepth/tracking/matching.hpp"
#include "docdepth/tracking/track.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// An object with fewer samples has no shape that could be matched.
constexpr std::size_t kMinSamples = 5;

/// What was seen once may be anywhere that max_speed reaches, so it is looked for in so many sweeps
/// only: with each one there are more places, and parked cars in some of them.
constexpr std::size_t kMaxSweepsUnknown = 3;
/// What touches a track but is none of it is kept as at most this many samples.
constexpr std::size_t kMaxNeighborSamples = 300;

constexpr int kFree = -1, kUntracked = -2;  // owners of a detection besides tracks

bool can_be_tracked(const Detection& object) {
  return object.box.size().z() >= kMinTrackedHeight && object.box.width() <= kMaxObjectWidth;
}

std::size_t sweeps_between(const TrackState& state, std::size_t sweep) {
  return std::max(sweep, state.sweep) - std::min(sweep, state.sweep);
}

class Tracker {
 public:
  Tracker(ReadDetections read, std::vector<double> times, const TrackingOptions& options,
          TellProgress progress)
      : read_(std::move(read)),
        times_(std::move(times)),
        options_(options),
        progress_(std::move(progress)) {}

  std::vector<Track> run() {
    for (std::size_t i = 0; i < times_.size(); ++i) ego_.add(*read_(i));
    const double steps = 2 * double(times_.size());
    for (std::size_t i = 0; i < times_.size(); ++i) {
      forward(i);
      progress_(double(i + 1) / steps);
    }
    active_.clear();
    std::vector<std::vector<int>> begin(times_.size());  // tracks by their first sweep
    for (std::size_t k = 0; k < tracks_.size(); ++k)
      begin[tracks_[k].observations.front().sweep].push_back(int(k));
    for (std::size_t i = times_.size(); i-- > 0;) {
      backward(i);
      for (const int k : begin[i])
        if (!tracks_[k].observations.empty()) active_.push_back(beginning(k));
      progress_(1 - double(i) / steps);
    }
    std::vector<Track> found;
    for (Track& track : tracks_)
      if (!track.observations.empty()) found.push_back(std::move(track));
    return found;
  }

 private:
  void forward(std::size_t sweep) {
    const auto detections = read_(sweep);
    const Detections& seen = *detections;
    std::vector<int> owners;
    for (const Detection& object : seen)
      owners.push_back(can_be_tracked(object) && !ego_.contains(object) ? kFree : kUntracked);
    owners_.push_back(std::move(owners));
    extend_tracks(sweep, [&](const TrackState& state, Match&&, TrackObservation&& observation) {
      append(state.track, std::move(observation));
      last_velocities_[std::size_t(state.track)] = state.velocity;
    });
    for (std::uint32_t k = 0; k < seen.size(); ++k)
      if (owners_[sweep][k] == kFree && seen[k].is_transient() &&
          seen[k].samples().size() >= kMinSamples)
        begin_track(sweep, detections, k);
  }

  void begin_track(std::size_t sweep, const std::shared_ptr<const Detections>& detections,
                   std::uint32_t k) {
    const Detection& seen = (*detections)[k];
    const int track = int(tracks_.size());
    tracks_.emplace_back();
    last_velocities_.emplace_back();
    append(track, observe(sweep, *detections, {k}));
    const TimedPoints samples{seen.samples(), seen.surface.times};
    active_.push_back({.track = track,
                       .sweep = sweep,
                       .detections = detections,
                       .samples = samples,
                       .last = samples,
                       .largest = seen.box.size(),
                       .time = times_[sweep],
                       .offset = seen.time_offset});
    active_.back().grade.add(times_[sweep], seen.ground);
  }

  void backward(std::size_t sweep) {
    extend_tracks(sweep, [&](TrackState& state, Match&& match, TrackObservation&& observation) {
      const int before = earlier_track(observation, *state.detections);
      if (before < 0)
        prepend(state.track, std::move(observation));
      else
        merge(before, state.track, match);
    });
    for (const int track : merged_) {
      const auto is_it = [&](const TrackState& state) { return state.track == track; };
      active_.erase(std::remove_if(active_.begin(), active_.end(), is_it), active_.end());
      reopened_.push_back(track);
    }
    merged_.clear();
    for (auto it = reopened_.begin(); it != reopened_.end();) {
      const bool begins = tracks_[*it].observations.front().sweep == sweep;
      if (begins) active_.push_back(beginning(*it));
      it = begins ? reopened_.erase(it) : it + 1;
    }
  }

  /// Let each active track find its continuation in a sweep; the longest chooses first.
  template <class Take>
  void extend_tracks(std::size_t sweep, const Take& take) {
    std::stable_sort(active_.begin(), active_.end(), [&](const TrackState& a, const TrackState& b) {
      return tracks_[a.track].observations.size() > tracks_[b.track].observations.size();
    });
    const auto detections = read_(sweep);
    const DetectionIndex index(*detections);
    std::vector<TrackState> active;
    for (TrackState& state : active_) {
      const double dt = times_[sweep] - state.time;
      if (is_lost(state, sweep)) continue;
      const auto may_take = [&](std::uint32_t k) { return is_free(sweep, k, state); };
      Match match = find_match(state, index, may_take, times_[sweep], options_.matching);
      if (match.score > 0 && may_merge(sweep, match, dt) &&
          !was_occupied_before(state, sweep, *detections, match)) {
        TrackObservation observation = observe(sweep, *detections, match.detections);
        observation.shift = match.shift;
        observation.shift_error = match.error;
        advance(state, match, observation);
        state.detections = detections;
        take(state, std::move(match), std::move(observation));
      }
      active.push_back(std::move(state));
    }
    active_ = std::move(active);
  }

  void advance(TrackState& state, const Match& match, const TrackObservation& observation) const {
    // What hides an object now may go away: all is kept that was seen of it.
    const bool stands = state.velocity.stands();
    const double dt = times_[observation.sweep] - state.time;
    state.velocity.add(match.shift, dt, match.error);
    state.offset = float(observation.time_offset);
    state.set_samples(match.hidden || stands ? state.samples : state.last, match.samples,
                      match.shift, dt);
    state.time = times_[observation.sweep];
    state.sweep = observation.sweep;
    state.grade.add(state.time, observation.ground);
    state.largest = match.largest;
    docdepth::append(state.neighbors, match.neighbors);
    state.neighbors = downsample(state.neighbors, kSampleSpacing, kMaxNeighborSamples);
  }

  void append(int track, TrackObservation&& observation) {
    own(track, observation);
    tracks_[track].observations.push_back(std::move(observation));
  }

  void prepend(int track, TrackObservation&& observation) {
    own(track, observation);
    auto& observations = tracks_[track].observations;
    observations.front().shift = -observation.shift;
    observations.front().shift_error = observation.shift_error;
    observation.shift = Vector::Zero();
    observations.insert(observations.begin(), std::move(observation));
  }

  void own(int track, const TrackObservation& observation) {
    for (const auto k : observation.detections) owners_[observation.sweep][k] = track;
    tracks_[track].transient_count += observation.is_transient;
  }

  /// Put an earlier track before a later one, whose backward match is the end of the earlier one.
  void merge(int before, int after, const Match& match) {
    auto& later = tracks_[after].observations;
    auto& earlier = tracks_[before].observations;
    later.front().shift = -match.shift;
    later.front().shift_error = match.error;
    later.insert(later.begin(), earlier.begin(), earlier.end());
    tracks_[after].transient_count += tracks_[before].transient_count;
    for (const TrackObservation& seen : earlier)
      for (const auto k : seen.detections) owners_[seen.sweep][k] = after;
    earlier = {};
    merged_.push_back(after);  // it goes on at its new beginning
  }

  /// The beginning of a track, from which it is followed backward.
  TrackState beginning(int track) const {
    const auto& seen = tracks_[track].observations;
    const auto samples_of = [&](const TrackObservation& of) {
      const auto detections = read_(of.sweep);
      TimedPoints samples;
      for (const auto k : of.detections) docdepth::append(samples, (*detections)[k]);
      return samples;
    };
    TrackState state{.track = track,
                     .sweep = seen[0].sweep,
                     .detections = read_(seen[0].sweep),
                     .last = samples_of(seen[0]),
                     .largest = seen[0].box.size(),
                     .time = times_[seen[0].sweep],
                     .offset = float(seen[0].time_offset)};
    for (const TrackObservation& of : seen) state.largest = state.largest.cwiseMax(of.box.size());
    for (std::size_t k = seen.size(); k-- > 0;)
      state.grade.add(times_[seen[k].sweep], seen[k].ground);
    state.samples = state.last;
    if (seen.size() == 1) return state;
    const double dt = state.time - times_[seen[1].sweep];
    state.set_samples(samples_of(seen[1]), samples_of(seen[0]), -seen[1].shift, dt);
    state.velocity.add(-seen[1].shift, dt, seen[1].shift_error);
    return state;
  }

  /// Whether the earlier track that a match ends, if any, goes as fast as the match says.
  bool may_merge(std::size_t sweep, const Match& match, double dt) const {
    for (const auto k : match.detections)
      if (const int owner = owners_[sweep][k];
          owner >= 0 &&
          !last_velocities_[std::size_t(owner)].allows(-match.shift, -dt, match.error))
        return false;
    return true;
  }

  /// The track that ends with most of the objects of a match; -1 if they are free.
  int earlier_track(const TrackObservation& observation, const Detections& detections) const {
    int found = -1;
    std::uint32_t most = 0;
    for (const auto k : observation.detections) {
      const int owner = owners_[observation.sweep][k];
      const std::uint32_t points = detections[k].points;
      if (owner < 0 || points <= most) continue;
      found = owner;
      most = points;
    }
    return found;
  }

  /// Whether a track was seen too long before a sweep, or too long after it, to go on there.
  bool is_lost(const TrackState& state, std::size_t sweep) const {
    if (!state.velocity.is_known && sweeps_between(state, sweep) > kMaxSweepsUnknown) return true;
    const bool stands = state.velocity.is_known && state.velocity.stands();
    const bool proven = tracks_[state.track].transient_count >= options_.min_detections;
    const double gap = stands && proven ? options_.max_gap_standing : options_.max_gap;
    return std::fabs(times_[sweep] - state.time) > gap + kTimeTolerance;
  }

  /// Whether a track may take a detection: it is nobody's, or the end of an earlier track.
  bool is_free(std::size_t sweep, std::uint32_t k, const TrackState& state) const {
    const int owner = owners_[sweep][k];
    if (owner < 0) return owner == kFree;
    return owner != state.track && tracks_[state.track].observations.front().sweep > sweep &&
           tracks_[owner].observations.back().sweep == sweep;
  }

  /// Whether what a track is matched with stood there already in the sweep that saw the track last:
  /// then it is something else, though a track that was hidden could have gone there.
  bool was_occupied_before(const TrackState& state, std::size_t sweep, const Detections& detections,
                           const Match& match) const {
    if (sweeps_between(state, sweep) < 2) return false;
    const Detections& then = *state.detections;
    const auto stood = [&](std::uint32_t k) {
      const Detection& object = detections[k];
      const auto lies_on = [&](const SampledPoints& others) {
        return matched_share(object.samples(), Vector::Zero(), others) >= kMinMemberShare;
      };
      if (object.is_transient() || lies_on(state.samples.points)) return false;
      for (std::uint32_t of = 0; of < then.size(); ++of)
        if (owners_[state.sweep][of] != state.track && !then[of].is_transient() &&
            then[of].box.overlaps(object.box, kMatchDistance) && lies_on(then[of].samples()))
          return true;
      return false;
    };
    return std::any_of(match.detections.begin(), match.detections.end(), stood);
  }

  ReadDetections read_;
  EgoBody ego_;
  std::vector<double> times_;
  TrackingOptions options_;
  TellProgress progress_;
  std::vector<Track> tracks_;
  std::vector<std::vector<int>> owners_;           ///< of each detection of each sweep
  std::vector<VelocityEstimate> last_velocities_;  ///< of each track, at its last observation
  std::vector<TrackState> active_;
  std::vector<int> merged_;    ///< tracks that an earlier one was put before, in this sweep
  std::vector<int> reopened_;  ///< tracks that are followed on from another beginning
};

}  // namespace

std::vector<Track> follow_objects(const ReadDetections& read, const std::vector<double>& times,
                                  const TrackingOptions& options, const TellProgress& progress) {
  return Tracker(read, times, options, progress).run();
}

}  // namespace docdepth
