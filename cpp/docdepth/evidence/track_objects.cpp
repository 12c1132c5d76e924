#include "docdepth/evidence/track_objects.hpp"

#include <algorithm>
#include <cmath>
#include <deque>
#include <memory>

#include "docdepth/detections/constants.hpp"
#include "docdepth/evidence/dynamic_voxels.hpp"
#include "docdepth/evidence/followed.hpp"
#include "docdepth/evidence/parts.hpp"
#include "docdepth/evidence/track_evidence.hpp"
#include "docdepth/geometry/parallel.hpp"
#include "docdepth/tracking/neighbors.hpp"
#include "docdepth/tracking/tracker.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

using Boxes = std::vector<std::pair<std::size_t, TrackBox>>;  ///< by sweep
using Members = std::vector<std::pair<std::size_t, Member>>;  ///< by sweep

/// Sweeps that are in memory, from `first` on.
struct HeldSweeps {
  std::size_t first = 0;
  std::vector<std::shared_ptr<const Detections>> detections;

  std::size_t end() const { return first + detections.size(); }
  const Detections& operator[](std::size_t sweep) const { return *detections[sweep - first]; }
};

/// Where the object of a track is in the sweeps in which that is known.
Boxes boxes_of(const Track& track, const TrackPath& path, std::uint32_t number,
               const std::vector<double>& times) {
  Boxes boxes;
  std::size_t first = track.observations.front().sweep, last = track.observations.back().sweep;
  while (first > 0 && path.covers(times[first - 1])) --first;
  while (last + 1 < times.size() && path.covers(times[last + 1])) ++last;
  for (std::size_t i = first; i <= last; ++i)
    if (path.covers(times[i]))
      boxes.push_back({i, {number, path.speed(times[i]) >= kStanding, path.box(times[i])}});
  return boxes;
}

/// The sweeps in which a track may have detections.
struct Reach {
  std::size_t first, last;
};

Reach reach_of(const TrackEvidence& evidence, const Track& track,
               const std::vector<double>& times) {
  std::size_t first = track.observations.front().sweep, last = track.observations.back().sweep;
  if (evidence.stands_before()) first = 0;
  if (evidence.stands_after()) last = times.size() - 1;
  while (first > 0 && evidence.covers(times[first - 1])) --first;
  while (last + 1 < times.size() && evidence.covers(times[last + 1])) ++last;
  return {first, last};
}

/// The detections of some sweeps that belong to a track, in order. Sweeps are asked in order, too.
Members members_of(TrackEvidence& evidence, const Track& track, std::uint32_t number,
                   const Reach& reach, const HeldSweeps& sweeps, std::size_t begin,
                   const std::vector<double>& times) {
  Members members;
  const std::size_t first = std::max(reach.first, begin),
                    end = std::min(reach.last + 1, sweeps.end());
  const auto before = [](const TrackObservation& seen, std::size_t i) { return seen.sweep < i; };
  auto seen = std::lower_bound(track.observations.begin(), track.observations.end(), first, before);
  for (std::size_t i = first; i < end; ++i) {
    while (seen != track.observations.end() && seen->sweep < i) ++seen;
    const bool is_seen = seen != track.observations.end() && seen->sweep == i;
    if (!is_seen && !evidence.covers(times[i])) continue;
    const Detections& objects = sweeps[i];
    std::vector<std::pair<const Detection*, bool>> found;
    const Detection* best = nullptr;  // of whose place most was free before or after
    for (std::uint32_t k = 0; k < objects.size(); ++k) {
      const bool is_member = is_seen && std::find(seen->objects.begin(), seen->objects.end(), k) !=
                                            seen->objects.end();
      const bool claimed = evidence.claims(i, objects[k], is_member);
      if (!is_member && !claimed) continue;
      found.push_back({&objects[k], claimed});
      if (!best || objects[k].passing_area() > best->passing_area()) best = &objects[k];
    }
    for (const auto& [object, claimed] : found)
      members.push_back(
          {i, {object->first, number, claimed && !evidence.are_apart(i, *object, *best)}});
  }
  return members;
}

/// Boxes reach down to the ground, since feet and wheels are often hidden: if more of the object
/// was seen than is missing below.
TrackedObject object_of(const Track& track, const TrackPath& path,
                        const std::vector<double>& times) {
  Extent extent = path.extent();
  if (path.has_ground() && extent.low.z() < extent.size().z())
    extent.low.z() = std::min(extent.low.z(), 0.0f);
  const Vector middle = 0.5f * (extent.low + extent.high);
  TrackedObject object{{}, extent.size(), path.is_rigid()};
  for (std::size_t n = 0; n < track.observations.size(); ++n) {
    const TrackObservation& seen = track.observations[n];
    Pose T = path.pose(times[seen.sweep]);
    T.translate(Vector(middle.x(), middle.y(), extent.low.z()).cast<double>());
    object.places.push_back({std::uint32_t(seen.sweep), seen.points, T,
                             path.velocity(times[seen.sweep]), path.deviation(n),
                             path.surface_deviation(n)});
  }
  return object;
}

/// The part of a track from one observation up to another.
Track part_of(const Track& track, std::size_t begin, std::size_t end) {
  Track part;
  part.observations.assign(track.observations.begin() + std::ptrdiff_t(begin),
                           track.observations.begin() + std::ptrdiff_t(end));
  for (const TrackObservation& seen : part.observations) part.dynamic += seen.dynamic;
  return part;
}

/// A track and what its observations saw, as far as they have been read.
struct SeenTrack {
  std::size_t number;  ///< among all
  Track track;
  std::vector<SeenSurface> surfaces;
};

/// What an observation saw, and when.
SeenSurface surface_of(const TrackObservation& seen, const Detections& detections) {
  SeenSurface surface;
  const auto append = [&](SampledPoints& points, std::vector<float>& times,
                          const SampledPoints& more, const std::vector<float>& more_times) {
    points.insert(points.end(), more.begin(), more.end());
    for (const float time : more_times) times.push_back(time - float(seen.time_offset));
  };
  for (const auto of : seen.objects) {
    const Detection& part = detections[of];
    const TimedSurface& its = part.surface;
    append(surface.points, surface.times, its.points, its.times);
    surface.normals.insert(surface.normals.end(), its.normals.begin(), its.normals.end());
    append(surface.edges.points, surface.edges.times, part.edges.points, part.edges.times);
    append(surface.hidden.points, surface.hidden.times, part.hidden.points, part.hidden.times);
  }
  return surface;
}

/// The track, cut where its surfaces say that it went on with another object, in order of time.
Paths cut(SeenTrack& whole, const std::vector<double>& times, const TrackParameters& p) {
  Paths single;
  std::vector<std::pair<Track, std::size_t>> open;  // and its first observation in the whole
  open.emplace_back(std::move(whole.track), 0);
  while (!open.empty()) {
    auto [next, first] = std::move(open.back());
    open.pop_back();
    if (next.dynamic < p.min_detections) continue;
    auto part =
        std::make_unique<const TrackAndPath>(std::move(next), &whole.surfaces[first], times, p);
    const auto& [track, path] = *part;
    if (path.is_one_object()) {
      single.push_back(std::move(part));
      continue;
    }
    // In order of time: the earliest part is taken out first.
    const std::size_t count = track.observations.size();
    if (path.end() < count)
      open.emplace_back(part_of(track, path.end(), count), first + path.end());
    open.emplace_back(part_of(track, path.begin(), path.end()), first + path.begin());
    if (path.begin() > 0) open.emplace_back(part_of(track, 0, path.begin()), first);
  }
  return single;
}

/// Tracks with enough dynamic observations, cut into single objects. Surfaces are kept from the
/// first observation of a track to its last.
Paths single_objects(std::vector<Track> tracks, DetectionWindow& detections,
                     const std::vector<double>& times, const TrackParameters& p, int threads) {
  std::vector<std::vector<std::size_t>> begin(times.size());  // tracks by their first sweep
  for (std::size_t k = 0; k < tracks.size(); ++k)
    if (tracks[k].dynamic >= p.min_detections)
      begin[tracks[k].observations.front().sweep].push_back(k);
    else
      tracks[k] = {};
  std::vector<Paths> parts(tracks.size());
  std::vector<SeenTrack> open, whole;
  const auto follow = [&] {
    parallel_for(whole.size(), 1, threads, [&](std::size_t k, std::size_t) {
      parts[whole[k].number] = cut(whole[k], times, p);
    });
    whole.clear();
  };
  for (std::size_t i = 0; i < times.size(); ++i) {
    for (const std::size_t k : begin[i]) open.push_back({k, std::move(tracks[k]), {}});
    for (SeenTrack& seen : open) {
      const auto& observations = seen.track.observations;
      if (observations[seen.surfaces.size()].sweep != i) continue;
      seen.surfaces.push_back(surface_of(observations[seen.surfaces.size()], detections[i]));
      if (seen.surfaces.size() == observations.size()) whole.push_back(std::move(seen));
    }
    const auto is_whole = [](const SeenTrack& seen) { return seen.track.observations.empty(); };
    open.erase(std::remove_if(open.begin(), open.end(), is_whole), open.end());
    if (whole.size() >= kTracksAtOnce) follow();
  }
  follow();
  Paths single;
  for (Paths& of : parts)
    for (auto& part : of) single.push_back(std::move(part));
  return single;
}

/// Finds what belongs to the tracks, from the first sweep to the last.
class SweepTracker {
 public:
  SweepTracker(const Paths& followed, const std::vector<double>& times, const TrackParameters& p,
               int threads)
      : followed_(followed),
        times_(times),
        p_(p),
        threads_(threads),
        evidence_(followed.size()),
        reach_(followed.size()),
        begin_(times.size()),
        result_(times.size()) {
    std::vector<Boxes> boxes(followed.size());
    parallel_for(followed.size(), 1, threads, [&](std::size_t k, std::size_t) {
      const auto& [track, path] = *followed[k];
      const auto number = std::uint32_t(k + 1);
      evidence_[k] = std::make_unique<TrackEvidence>(*followed[k], number, times, p, result_);
      if (p.window > 0 && !is_rail(*followed[k])) boxes[k] = boxes_of(track, path, number, times);
      reach_[k] = reach_of(*evidence_[k], track, times);
    });
    for (const Boxes& of : boxes)
      for (const auto& [sweep, box] : of) result_[sweep].boxes.push_back(box);
    for (std::size_t k = 0; k < followed.size(); ++k) begin_[reach_[k].first].push_back(k);
  }

  void run(const ReadDetections& read, const TakeSweep& take, std::size_t held) {
    while (held_.end() < times_.size()) {
      const std::size_t begin = held_.end();
      const std::size_t end = std::min(times_.size(), begin + held);
      for (std::size_t i = begin; i < end; ++i) held_.detections.push_back(read(i));
      find_members(begin);
      find_voxels();
      for (; given_ < found_; ++given_) take(result_[given_]);
      forget();
    }
  }

 private:
  void find_members(std::size_t begin) {
    const std::size_t end = held_.end();
    const auto is_past = [&](std::size_t k) { return reach_[k].last < begin; };
    active_.erase(std::remove_if(active_.begin(), active_.end(), is_past), active_.end());
    for (std::size_t i = begin; i < end; ++i)
      active_.insert(active_.end(), begin_[i].begin(), begin_[i].end());
    std::sort(active_.begin(), active_.end());
    std::vector<Members> members(active_.size());
    parallel_for(active_.size(), 1, threads_, [&](std::size_t n, std::size_t) {
      const std::size_t k = active_[n];
      members[n] = members_of(*evidence_[k], followed_[k]->track, std::uint32_t(k + 1), reach_[k],
                              held_, begin, times_);
    });
    for (const Members& of : members)
      for (const auto& [sweep, member] : of) result_[sweep].members.push_back(member);
    for (std::size_t i = begin; i < end; ++i)
      std::stable_sort(result_[i].members.begin(), result_[i].members.end(),
                       [](const Member& a, const Member& b) { return a.first < b.first; });
  }

  bool is_within(std::size_t earlier, std::size_t later) const {
    return times_[later] - times_[earlier] <= p_.window + kTimeTolerance;
  }

  /// Of the sweeps whose window has been read.
  void find_voxels() {
    const std::size_t begin = found_, end = held_.end();
    while (found_ < end && (end == times_.size() || !is_within(found_, end - 1))) ++found_;
    parallel_for(found_ - begin, 1, threads_, [&](std::size_t n, std::size_t) {
      result_[begin + n].voxels =
          dynamic_voxels(begin + n, held_.first, held_.detections, times_, result_, p_.window);
    });
  }

  /// Let go of sweeps that no later one needs; their boxes stay.
  void forget() {
    std::size_t past = 0;
    while (held_.first + past < found_ &&
           (found_ == times_.size() || !is_within(held_.first + past, found_))) {
      result_[held_.first + past].members = {}, result_[held_.first + past].voxels = {};
      ++past;
    }
    held_.detections.erase(held_.detections.begin(),
                           held_.detections.begin() + std::ptrdiff_t(past));
    held_.first += past;
  }

  const Paths& followed_;
  const std::vector<double>& times_;
  const TrackParameters& p_;
  const int threads_;
  std::vector<std::unique_ptr<TrackEvidence>> evidence_;
  std::vector<Reach> reach_;
  std::vector<std::vector<std::size_t>> begin_;  ///< tracks by the first sweep in reach
  std::vector<std::size_t> active_;              ///< tracks in reach of the sweeps in hand
  std::vector<TrackedSweep> result_;
  HeldSweeps held_;
  std::size_t found_ = 0, given_ = 0;  ///< sweeps whose voxels are known; that were handed out
};

}  // namespace

bool TrackedSweep::claims(std::uint32_t first) const {
  const auto before = [](const Member& member, std::uint32_t row) { return member.first < row; };
  auto member = std::lower_bound(members.begin(), members.end(), first, before);
  for (; member != members.end() && member->first == first; ++member)
    if (member->dynamic) return true;
  return false;
}

std::vector<TrackedObject> track_objects(const ReadDetections& read,
                                         const std::vector<double>& times, const TrackParameters& p,
                                         int threads, const TakeSweep& take, std::size_t held) {
  Paths followed;
  {
    DetectionWindow detections(read, held);
    const auto add_moving = [&](std::vector<Track> tracks) {
      for (auto& one : single_objects(std::move(tracks), detections, times, p, threads))
        if (moves(*one, times, p)) followed.push_back(std::move(one));
    };
    add_moving(follow_objects(detections, times, p));
    add_moving(join_parts(followed, times, p));
    std::stable_sort(followed.begin(), followed.end(), [](const auto& a, const auto& b) {
      return a->track.observations.size() > b->track.observations.size();
    });
  }
  SweepTracker(followed, times, p, threads).run(read, take, held);
  std::vector<TrackedObject> objects(followed.size());
  parallel_for(followed.size(), 16, threads, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k)
      objects[k] = object_of(followed[k]->track, followed[k]->path, times);
  });
  return objects;
}

}  // namespace docdepth
