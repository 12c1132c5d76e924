#include "docdepth/evidence/track_objects.hpp"

#include <algorithm>
#include <cmath>
#include <deque>
#include <functional>
#include <memory>
#include <utility>

#include "docdepth/evidence/fragments.hpp"
#include "docdepth/evidence/object_track.hpp"
#include "docdepth/evidence/points_inside.hpp"
#include "docdepth/evidence/single_objects.hpp"
#include "docdepth/evidence/track_evidence.hpp"
#include "docdepth/geometry/parallel.hpp"
#include "docdepth/tracking/constants.hpp"
#include "docdepth/tracking/detection_index.hpp"
#include "docdepth/tracking/tracker.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

using Boxes = std::vector<std::pair<std::size_t, TrackedBox>>;  ///< by sweep
using Members = std::vector<std::pair<std::size_t, Member>>;    ///< by sweep

/// The detections that were asked for last. So memory does not grow with the drive.
class DetectionWindow {
 public:
  /// @param size  so many sweeps, at least 1
  DetectionWindow(ReadDetections read, std::size_t size) : read_(std::move(read)), size_(size) {}

  std::shared_ptr<const Detections> operator()(std::size_t sweep) {
    for (auto it = recent_.rbegin(); it != recent_.rend(); ++it)
      if (it->first == sweep) return it->second;
    if (recent_.size() == size_) recent_.pop_front();
    recent_.emplace_back(sweep, read_(sweep));
    return recent_.back().second;
  }

 private:
  ReadDetections read_;
  std::size_t size_;
  std::deque<std::pair<std::size_t, std::shared_ptr<const Detections>>> recent_;
};

/// Sweeps that are in memory, from `first` on.
struct SweepBuffer {
  std::size_t first = 0;
  std::vector<std::shared_ptr<const Detections>> detections;
  std::vector<DetectionIndex> indices;  ///< of each of them

  std::size_t end() const { return first + detections.size(); }
  const DetectionIndex& operator[](std::size_t sweep) const { return indices[sweep - first]; }
  void push_back(std::shared_ptr<const Detections> sweep) {
    indices.emplace_back(*sweep);
    detections.push_back(std::move(sweep));
  }
  void drop(std::size_t count) {
    detections.erase(detections.begin(), detections.begin() + std::ptrdiff_t(count));
    indices.erase(indices.begin(), indices.begin() + std::ptrdiff_t(count));
    first += count;
  }
};

/// Where an object is in the sweeps in which that is known.
Boxes boxes_of(const ObjectTrack& object, std::uint32_t number, const std::vector<double>& times) {
  const auto& [track, path] = object;
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
  std::size_t first = 0, last = 0;
};

Reach reach_of(const TrackEvidence& evidence, const std::vector<double>& times) {
  const auto& observations = evidence.object().track.observations;
  std::size_t first = observations.front().sweep, last = observations.back().sweep;
  if (evidence.stands_before()) first = 0;
  if (evidence.stands_after()) last = times.size() - 1;
  while (first > 0 && evidence.covers(times[first - 1])) --first;
  while (last + 1 < times.size() && evidence.covers(times[last + 1])) ++last;
  return {first, last};
}

/// The detections of some sweeps that belong to a track, in order. Sweeps are asked in order, too.
Members members_of(TrackEvidence& evidence, const Reach& within, const SweepBuffer& sweeps,
                   std::size_t begin, const std::vector<double>& times) {
  const auto& observations = evidence.object().track.observations;
  Members members;
  const std::size_t first = std::max(within.first, begin),
                    end = std::min(within.last + 1, sweeps.end());
  const auto before = [](const TrackObservation& seen, std::size_t i) { return seen.sweep < i; };
  auto seen = std::lower_bound(observations.begin(), observations.end(), first, before);
  for (std::size_t i = first; i < end; ++i) {
    while (seen != observations.end() && seen->sweep < i) ++seen;
    const bool is_seen = seen != observations.end() && seen->sweep == i;
    if (!is_seen && !evidence.covers(times[i])) continue;
    const Detections& detections = sweeps[i].detections();
    std::vector<std::uint32_t> near;
    if (const auto reach = evidence.reach(times[i])) near = sweeps[i].near(*reach, 0);
    if (is_seen) {
      near.insert(near.end(), seen->detections.begin(), seen->detections.end());
      std::sort(near.begin(), near.end());
      near.erase(std::unique(near.begin(), near.end()), near.end());
    }
    std::vector<std::pair<const Detection*, bool>> found;
    const Detection* best = nullptr;  // of whose place most was free before or after
    for (const auto k : near) {
      const bool is_member = is_seen && std::find(seen->detections.begin(), seen->detections.end(),
                                                  k) != seen->detections.end();
      const bool dynamic = evidence.makes_dynamic(times[i], detections[k], is_member);
      if (!is_member && !dynamic) continue;
      found.push_back({&detections[k], dynamic});
      if (!best || detections[k].transient_area() > best->transient_area()) best = &detections[k];
    }
    for (const auto& [object, dynamic] : found)
      members.push_back({i,
                         {object->first, evidence.number(),
                          dynamic && !evidence.are_apart(times[i], *object, *best)}});
  }
  return members;
}

/// Boxes reach down to the ground, since feet and wheels are often hidden: if more of the object
/// was seen than is missing below.
TrackedObject object_of(const ObjectTrack& object, const std::vector<double>& times) {
  const auto& [track, path] = object;
  Extent extent = path.extent();
  if (path.has_ground() && extent.low.z() < extent.size().z())
    extent.low.z() = std::min(extent.low.z(), 0.0f);
  const Vector middle = 0.5f * (extent.low + extent.high);
  TrackedObject tracked{.size = extent.size(), .rigid = path.is_rigid()};
  for (std::size_t n = 0; n < track.observations.size(); ++n) {
    const TrackObservation& seen = track.observations[n];
    Pose T = path.pose(times[seen.sweep]);
    T.translate(Vector(middle.x(), middle.y(), extent.low.z()).cast<double>());
    tracked.places.push_back({.sweep = std::uint32_t(seen.sweep),
                              .points = seen.points,
                              .T_world_object = T,
                              .velocity = path.velocity(times[seen.sweep]),
                              .deviation = path.deviation(n),
                              .surface_deviation = path.surface_deviation(n)});
  }
  return tracked;
}

/// Finds what belongs to the tracks, from the first sweep to the last.
class SweepTracker {
 public:
  SweepTracker(std::vector<ObjectTrack> objects, std::vector<double> times,
               const TrackingOptions& options, int threads)
      : times_(std::move(times)),
        window_(options.window),
        threads_(threads),
        reach_(objects.size()),
        begin_(times_.size()),
        result_(times_.size()) {
    for (ObjectTrack& object : objects)
      evidence_.emplace_back(std::move(object), std::uint32_t(evidence_.size() + 1), times_,
                             options);
    std::vector<Boxes> boxes(evidence_.size());
    parallel_for(evidence_.size(), 1, threads, [&](std::size_t k, std::size_t) {
      const TrackEvidence& evidence = evidence_[k];
      if (window_ > 0) boxes[k] = boxes_of(evidence.object(), evidence.number(), times_);
      reach_[k] = reach_of(evidence, times_);
    });
    for (const Boxes& of : boxes)
      for (const auto& [sweep, box] : of) result_[sweep].boxes.push_back(box);
    for (std::size_t k = 0; k < evidence_.size(); ++k) begin_[reach_[k].first].push_back(k);
  }

  void run(const ReadDetections& read, const TakeSweep& take, std::size_t buffer_size,
           const TellProgress& progress) {
    while (buffer_.end() < times_.size()) {
      const std::size_t begin = buffer_.end();
      const std::size_t end = std::min(times_.size(), begin + buffer_size);
      for (std::size_t i = begin; i < end; ++i) buffer_.push_back(read(i));
      find_members(begin);
      find_voxels();
      for (; given_ < found_; ++given_) take(result_[given_]);
      progress(double(given_) / double(times_.size()));
      drop_past();
    }
  }

  std::vector<TrackedObject> objects() const {
    std::vector<TrackedObject> objects(evidence_.size());
    parallel_for(evidence_.size(), 16, threads_, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k)
        objects[k] = object_of(evidence_[k].object(), times_);
    });
    return objects;
  }

 private:
  void find_members(std::size_t begin) {
    const std::size_t end = buffer_.end();
    const auto is_past = [&](std::size_t k) { return reach_[k].last < begin; };
    active_.erase(std::remove_if(active_.begin(), active_.end(), is_past), active_.end());
    for (std::size_t i = begin; i < end; ++i)
      active_.insert(active_.end(), begin_[i].begin(), begin_[i].end());
    std::sort(active_.begin(), active_.end());
    std::vector<Members> members(active_.size());
    parallel_for(active_.size(), 1, threads_, [&](std::size_t n, std::size_t) {
      const std::size_t k = active_[n];
      members[n] = members_of(evidence_[k], reach_[k], buffer_, begin, times_);
    });
    for (const Members& of : members)
      for (const auto& [sweep, member] : of) result_[sweep].members.push_back(member);
    for (std::size_t i = begin; i < end; ++i)
      std::stable_sort(result_[i].members.begin(), result_[i].members.end(),
                       [](const Member& a, const Member& b) { return a.first < b.first; });
  }

  bool is_within(std::size_t earlier, std::size_t later) const {
    return times_[later] - times_[earlier] <= window_ + kTimeTolerance;
  }

  /// Of the sweeps whose window has been read.
  void find_voxels() {
    const std::size_t begin = found_, end = buffer_.end();
    while (found_ < end && (end == times_.size() || !is_within(found_, end - 1))) ++found_;
    parallel_for(found_ - begin, 1, threads_, [&](std::size_t n, std::size_t) {
      result_[begin + n].voxels =
          dynamic_voxels(begin + n, buffer_.first, buffer_.detections, times_, result_, window_);
    });
  }

  /// Drop the sweeps that no later one needs; their boxes stay.
  void drop_past() {
    std::size_t past = 0;
    while (buffer_.first + past < found_ &&
           (found_ == times_.size() || !is_within(buffer_.first + past, found_))) {
      result_[buffer_.first + past].members = {};
      result_[buffer_.first + past].voxels = {};
      ++past;
    }
    buffer_.drop(past);
  }

  std::vector<double> times_;
  double window_;  ///< of TrackingOptions [s]
  int threads_;
  std::vector<TrackEvidence> evidence_;
  std::vector<Reach> reach_;
  std::vector<std::vector<std::size_t>> begin_;  ///< tracks by the first sweep in reach
  std::vector<std::size_t> active_;              ///< tracks in reach of the sweeps in hand
  std::vector<TrackedSweep> result_;
  SweepBuffer buffer_;
  std::size_t found_ = 0;  ///< sweeps whose voxels are known
  std::size_t given_ = 0;  ///< sweeps that were handed out
};

}  // namespace

bool TrackedSweep::makes_dynamic(std::uint32_t first) const {
  const auto before = [](const Member& member, std::uint32_t row) { return member.first < row; };
  auto member = std::lower_bound(members.begin(), members.end(), first, before);
  for (; member != members.end() && member->first == first; ++member)
    if (member->is_dynamic) return true;
  return false;
}

std::vector<TrackedObject> track_objects(const ReadDetections& read,
                                         const std::vector<double>& times, int threads,
                                         const TakeSweep& take, std::size_t buffer_size,
                                         const TrackingOptions& options,
                                         const TellProgress& progress) {
  // Most of the work is to follow objects, then to find their paths.
  const auto part = [&](double begin, double end) {
    return [&progress, begin, end](double share) { progress(begin + share * (end - begin)); };
  };
  std::vector<ObjectTrack> objects;
  {
    DetectionWindow window(read, buffer_size);
    const auto add_moving = [&](std::vector<Track> tracks, const TellProgress& of_paths) {
      for (auto& one :
           single_objects(std::move(tracks), std::ref(window), times, options, threads, of_paths))
        if (moves(one, times, options)) objects.push_back(std::move(one));
    };
    add_moving(follow_objects(std::ref(window), times, options, part(0, 0.6)), part(0.6, 0.85));
    add_moving(merge_fragments(objects, times, options), part(0.85, 0.9));
  }
  // They were followed only since they may be fragments of vehicles.
  objects.erase(std::remove_if(objects.begin(), objects.end(),
                               [](const ObjectTrack& of) { return is_rail(of.path); }),
                objects.end());
  std::stable_sort(objects.begin(), objects.end(), [](const auto& a, const auto& b) {
    return a.track.observations.size() > b.track.observations.size();
  });
  SweepTracker tracker(std::move(objects), times, options, threads);
  tracker.run(read, take, buffer_size, part(0.9, 1));
  return tracker.objects();
}

}  // namespace docdepth
