#include "docdepth/tracking/tracker.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/detections/constants.hpp"
#include "docdepth/tracking/ego_places.hpp"
#include "docdepth/tracking/matching.hpp"
#include "docdepth/tracking/track_end.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

constexpr int kFree = -1, kUntracked = -2;  // owners of a detection besides tracks

double mean_time_offset(const Detections& seen, const std::vector<std::uint32_t>& objects) {
  double offset = 0, points = 0;
  for (const auto k : objects)
    offset += double(seen[k].time_offset) * seen[k].points, points += seen[k].points;
  return offset / points;
}

bool can_be_tracked(const Detection& object) {
  return object.box.size().z() >= kMinTrackedHeight && object.box.width() <= kMaxObjectWidth;
}

/// Under the object of most points.
Height ground_under(const Detections& seen, const std::vector<std::uint32_t>& objects) {
  const auto fewer = [&](auto a, auto b) { return seen[a].points < seen[b].points; };
  return seen[*std::max_element(objects.begin(), objects.end(), fewer)].ground;
}

class Tracker {
 public:
  Tracker(DetectionWindow& detections, const std::vector<double>& times, const TrackParameters& p)
      : detections_(detections), times_(times), p_(p) {}

  std::vector<Track> run() {
    for (std::size_t i = 0; i < times_.size(); ++i) ego_.add(detections_[i]);
    for (std::size_t i = 0; i < times_.size(); ++i) forward(i);
    alive_.clear();
    std::vector<std::vector<int>> begin(times_.size());  // tracks by their first sweep
    for (std::size_t k = 0; k < tracks_.size(); ++k)
      begin[tracks_[k].observations.front().sweep].push_back(int(k));
    for (std::size_t i = times_.size(); i-- > 0;) {
      backward(i);
      for (const int k : begin[i])
        if (!tracks_[k].observations.empty()) alive_.push_back(beginning(k));
    }
    std::vector<Track> found;
    for (Track& track : tracks_)
      if (!track.observations.empty()) found.push_back(std::move(track));
    return found;
  }

 private:
  void forward(std::size_t sweep) {
    const Detections& seen = detections_[sweep];
    std::vector<int> owners;
    for (const Detection& object : seen)
      owners.push_back(can_be_tracked(object) && !ego_.hold(object) ? kFree : kUntracked);
    owners_.push_back(std::move(owners));
    go_on(sweep, [&](const TrackEnd& end, Match&& match) {
      add(end.track, sweep, match, false);
      last_speeds_[std::size_t(end.track)] = end.speed;
    });
    for (std::uint32_t k = 0; k < seen.size(); ++k) {
      if (owners_[sweep][k] != kFree || !seen[k].is_passing() ||
          seen[k].samples().size() < kMinSamples)
        continue;
      const int track = int(tracks_.size());
      owners_[sweep][k] = track;
      tracks_.push_back({{{sweep,
                           {k},
                           seen[k].box,
                           Vector::Zero(),
                           0,
                           true,
                           seen[k].is_dynamic(),
                           seen[k].area,
                           seen[k].passing_area(),
                           seen[k].free_area,
                           seen[k].points,
                           mean_time_offset(seen, {k}),
                           seen[k].ground}},
                         1});
      last_speeds_.emplace_back();
      const TimedPoints samples{seen[k].samples(), seen[k].surface.times};
      alive_.push_back({track,
                        sweep,
                        detections_.hold(sweep),
                        samples,
                        samples,
                        seen[k].box.size(),
                        times_[sweep],
                        seen[k].time_offset,
                        {},
                        {},
                        seen[k].area});
      alive_.back().elevation.add(times_[sweep], seen[k].ground);
    }
  }

  void backward(std::size_t sweep) {
    go_on(sweep, [&](TrackEnd& end, Match&& match) {
      const int before = earlier_track(sweep, match);
      if (before < 0) return add(end.track, sweep, match, true);
      // What the two have in common is the last observation of the earlier track.
      auto& later = tracks_[end.track].observations;
      auto& earlier = tracks_[before].observations;
      later.front().shift = -match.shift;
      later.front().shift_error = match.error;
      later.insert(later.begin(), earlier.begin(), earlier.end());
      tracks_[end.track].dynamic += tracks_[before].dynamic;
      for (const TrackObservation& seen : earlier)
        for (const auto k : seen.objects) owners_[seen.sweep][k] = end.track;
      earlier = {};
      gone_.push_back(end.track);  // it goes on at its new beginning
    });
    for (const int track : gone_) {
      const auto is_it = [&](const TrackEnd& end) { return end.track == track; };
      alive_.erase(std::remove_if(alive_.begin(), alive_.end(), is_it), alive_.end());
      joined_.push_back(track);
    }
    gone_.clear();
    for (auto it = joined_.begin(); it != joined_.end();) {
      const bool begins = tracks_[*it].observations.front().sweep == sweep;
      if (begins) alive_.push_back(beginning(*it));
      it = begins ? joined_.erase(it) : it + 1;
    }
  }

  /// Let each living track find its continuation in a sweep; the longest chooses first.
  template <class Take>
  void go_on(std::size_t sweep, const Take& take) {
    std::stable_sort(alive_.begin(), alive_.end(), [&](const TrackEnd& a, const TrackEnd& b) {
      return tracks_[a.track].observations.size() > tracks_[b.track].observations.size();
    });
    std::vector<TrackEnd> alive;
    for (TrackEnd& end : alive_) {
      const double dt = times_[sweep] - end.time;
      if (is_lost(end, sweep)) continue;
      std::vector<bool> free(owners_[sweep].size());
      for (std::uint32_t k = 0; k < free.size(); ++k) free[k] = is_free(sweep, k, end);
      Match match = find_match(end, detections_[sweep], free, times_[sweep], p_.max_speed);
      if (match.score > 0 && can_join(sweep, match, dt) && !was_there(end, sweep, match)) {
        move_on(end, sweep, match);
        take(end, std::move(match));
      }
      alive.push_back(std::move(end));
    }
    alive_ = std::move(alive);
  }

  void move_on(TrackEnd& end, std::size_t sweep, const Match& match) const {
    // What hides an object now may go away: all is kept that was seen of it.
    const bool partial = match.hidden || match.area < kPartialShare * end.area;
    const bool stands = end.speed.velocity.norm() < kStanding;
    const double dt = times_[sweep] - end.time;
    end.speed.add(match.shift, dt, match.error);
    if (!partial) end.area = match.area;
    end.offset = float(mean_time_offset(detections_[sweep], match.objects));
    end.hold(partial || stands ? end.samples : end.last, match.samples, match.shift, dt);
    end.time = times_[sweep];
    end.sweep = sweep;
    end.seen = detections_.hold(sweep);
    end.elevation.add(end.time, ground_under(detections_[sweep], match.objects));
    end.largest = match.largest;
    append(end.neighbors, match.neighbors);
    end.neighbors = downsample(end.neighbors, kSampleSpacing, kMaxNeighborSamples);
  }

  void add(int track, std::size_t sweep, const Match& match, bool at_front) {
    const Detections& seen = detections_[sweep];
    TrackObservation added{sweep,
                           match.objects,
                           match.box,
                           match.shift,
                           match.error,
                           false,
                           false,
                           0,
                           0,
                           0,
                           0,
                           mean_time_offset(seen, match.objects),
                           ground_under(seen, match.objects)};
    std::uint32_t points = 0, of_dynamic = 0, voted = 0;
    for (const auto k : match.objects) {
      owners_[sweep][k] = track;
      points += seen[k].points;
      added.area += seen[k].area;
      added.passing_area += seen[k].passing_area();
      added.free_area += seen[k].free_area;
      if (seen[k].is_passing()) of_dynamic += seen[k].points;
      if (seen[k].is_dynamic()) voted += seen[k].points;
    }
    added.points = points;
    added.dynamic = 2 * of_dynamic >= points;
    added.voted = 2 * voted >= points;
    tracks_[track].dynamic += added.dynamic;
    auto& observations = tracks_[track].observations;
    if (at_front) {
      observations.front().shift = -match.shift;
      observations.front().shift_error = match.error;
      added.shift = Vector::Zero();
      observations.insert(observations.begin(), std::move(added));
    } else {
      observations.push_back(std::move(added));
    }
  }

  /// The beginning of a track, from which it is followed backward.
  TrackEnd beginning(int track) const {
    const auto& seen = tracks_[track].observations;
    const auto samples_of = [&](const TrackObservation& of) {
      TimedPoints samples;
      for (const auto k : of.objects) append(samples, detections_[of.sweep][k]);
      return samples;
    };
    TrackEnd end{track,
                 seen[0].sweep,
                 detections_.hold(seen[0].sweep),
                 {},
                 samples_of(seen[0]),
                 seen[0].box.size(),
                 times_[seen[0].sweep],
                 float(seen[0].time_offset),
                 {},
                 {},
                 seen[0].area};
    for (const TrackObservation& of : seen) end.largest = end.largest.cwiseMax(of.box.size());
    for (std::size_t k = seen.size(); k-- > 0;)
      end.elevation.add(times_[seen[k].sweep], seen[k].ground);
    end.samples = end.last;
    if (seen.size() == 1) return end;
    const double dt = end.time - times_[seen[1].sweep];
    end.hold(samples_of(seen[1]), samples_of(seen[0]), -seen[1].shift, dt);
    end.speed.add(-seen[1].shift, dt, seen[1].shift_error);
    return end;
  }

  /// Whether the earlier track that a match ends, if any, goes as fast as the match says.
  bool can_join(std::size_t sweep, const Match& match, double dt) const {
    for (const auto k : match.objects)
      if (const int owner = owners_[sweep][k];
          owner >= 0 && !last_speeds_[std::size_t(owner)].allows(-match.shift, -dt, match.error))
        return false;
    return true;
  }

  /// The track that ends with most of the objects of a match; -1 if they are free. The others are
  /// dropped from the match.
  int earlier_track(std::size_t sweep, Match& match) const {
    int found = -1;
    std::uint32_t most = 0;
    for (const auto k : match.objects)
      if (owners_[sweep][k] >= 0 && detections_[sweep][k].points > most)
        found = owners_[sweep][k], most = detections_[sweep][k].points;
    if (found < 0) return found;
    auto& objects = match.objects;
    objects.erase(std::remove_if(objects.begin(), objects.end(),
                                 [&](auto k) { return owners_[sweep][k] != found; }),
                  objects.end());
    return found;
  }

  /// Whether a track was seen too long before a sweep, or too long after it, to go on there.
  bool is_lost(const TrackEnd& end, std::size_t sweep) const {
    if (!end.speed.is_known && sweeps_between(end, sweep) > kMaxSweepsUnknown) return true;
    const bool stands = end.speed.is_known && end.speed.velocity.norm() < kStanding;
    const bool proven = tracks_[end.track].dynamic >= p_.min_detections;
    const double gap = stands && proven ? p_.max_gap_standing : p_.max_gap;
    return std::fabs(times_[sweep] - end.time) > gap + kTimeTolerance;
  }

  static std::size_t sweeps_between(const TrackEnd& end, std::size_t sweep) {
    return std::max(sweep, end.sweep) - std::min(sweep, end.sweep);
  }

  /// Whether a track may take a detection: it is nobody's, or the end of an earlier track.
  bool is_free(std::size_t sweep, std::uint32_t k, const TrackEnd& end) const {
    const int owner = owners_[sweep][k];
    if (owner < 0) return owner == kFree;
    return owner != end.track && tracks_[end.track].observations.front().sweep > sweep &&
           tracks_[owner].observations.back().sweep == sweep;
  }

  /// Whether what a track is matched with stood there already in the sweep that saw the track last:
  /// then it is something else, though a track that was hidden could have gone there.
  bool was_there(const TrackEnd& end, std::size_t sweep, const Match& match) const {
    if (sweeps_between(end, sweep) < 2) return false;
    const Detections& then = *end.seen;
    const auto stood = [&](std::uint32_t k) {
      const Detection& object = detections_[sweep][k];
      const auto lies_on = [&](const SampledPoints& others) {
        return matched_share(object.samples(), Vector::Zero(), others) >= kMinMemberShare;
      };
      if (object.is_passing() || lies_on(end.samples.points)) return false;
      for (std::uint32_t of = 0; of < then.size(); ++of)
        if (owners_[end.sweep][of] != end.track && !then[of].is_passing() &&
            then[of].box.overlaps(object.box, kMatchDistance) && lies_on(then[of].samples()))
          return true;
      return false;
    };
    return std::any_of(match.objects.begin(), match.objects.end(), stood);
  }

  DetectionWindow& detections_;
  EgoPlaces ego_;
  const std::vector<double>& times_;
  const TrackParameters& p_;
  std::vector<Track> tracks_;
  std::vector<std::vector<int>> owners_;  ///< of each detection of each sweep
  std::vector<Speed> last_speeds_;        ///< of each track, at its last observation
  std::vector<TrackEnd> alive_;
  std::vector<int> gone_, joined_;  ///< tracks that are followed on from another beginning
};

}  // namespace

std::vector<Track> follow_objects(DetectionWindow& detections, const std::vector<double>& times,
                                  const TrackParameters& p) {
  return Tracker(detections, times, p).run();
}

}  // namespace docdepth
