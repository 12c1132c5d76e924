#include "docdepth/objects/tracking.hpp"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/objects/constants.hpp"
#include "docdepth/objects/dynamic_voxels.hpp"
#include "docdepth/objects/tracker.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// Whether it is large and solid enough for what comes and goes without being seen to move. Pieces
/// of walls that show behind something are flat.
bool is_vehicle(const TrackPath& path) {
  const Vector size = path.extent().size();
  return path.is_rigid() && size.head<2>().minCoeff() >= kMinVehicleWidth &&
         size.z() >= kMinVehicleHeight;
}

/// Whether it is a long, thin thing that seems to go along itself. What is seen of a guard rail
/// goes along with us, or with a car that hides the rest.
bool is_rail(const TrackPath& path) {
  const Vector size = path.extent().size();
  return path.is_rigid() && size.x() >= kMinRailLength && size.y() < kMinVehicleWidth;
}

/// A track and its path, and what both say about detections.
class TrackEvidence {
 public:
  /// @param tracked  with the boxes of all tracks
  TrackEvidence(const Track& track, const TrackPath& path, std::uint32_t number,
                const std::vector<double>& times, const TrackParameters& p,
                const std::vector<TrackedSweep>& tracked)
      : track_(track), path_(path), number_(number), times_(times), p_(p), tracked_(tracked) {
    float total = 0;
    for (const TrackObservation& seen : track.observations) {
      total += seen.passing_area;
      supported_ = std::max({supported_, seen.passing_area, total / kTotalSupportDivisor});
    }
    std::size_t first = 0, last = track.observations.size() - 1;
    while (first < last && path.deviation(first) > kSamePlace) ++first;
    while (first < last && path.deviation(last) > kSamePlace) --last;
    first_known_ = times[track.observations[first].sweep];
    last_known_ = times[track.observations[last].sweep];
  }

  /// Whether it is known where the object is: it stays where it stands when it is last seen.
  bool covers(double time) const {
    return path_.covers(time) || (time < first_known_ && path_.speed(first_known_) < kStanding) ||
           (time > last_known_ && path_.speed(last_known_) < kStanding);
  }

  /// Whether the object moves at some time: by its path, or as it was not there before or after.
  bool moves() const {
    if (track_.dynamic < p_.min_detections || is_rail(path_)) return false;
    if (path_.distance(false) >= p_.min_distance &&
        path_.distance(true) >= kMinVotedDistanceShare * p_.min_distance)
      return true;
    return is_vehicle(path_) && appears();
  }

  /// Whether it moved while the votes called it dynamic.
  bool seen_to_move() const {
    const auto& seen = track_.observations;
    std::optional<Eigen::Vector2d> first;
    double most = 0;
    for (const TrackObservation& at : seen) {
      if (!at.voted) continue;
      const Eigen::Vector2d place = path_.pose(times_[at.sweep]).translation().head<2>();
      if (!first) first = place;
      most = std::max(most, (place - *first).norm());
    }
    return most >= p_.min_distance;
  }

  /// Whether the track makes a detection of a sweep dynamic.
  bool claims(std::size_t sweep, const Detection& object, bool is_member) {
    if (object.dynamic == object.points || object.box.width() < kMinTrackedWidth) return false;
    if (object.area - object.dynamic_area > supported_) return false;
    const double time = std::clamp(times_[sweep], first_known_, last_known_);
    if (is_member) return was_free(object, time);
    if (!lies_there(object, time, kSearchMargin) || !was_free(object, time)) return false;
    if (object.free_area >= kFreeEdges * object.area) return true;
    // Beside where it only passes, and where it is not seen any more, something else may stand.
    if (!path_.covers(times_[sweep])) return false;
    return path_.speed(time) < kSlow ||
           (path_.is_rigid() && lies_there(object, time, kObjectMargin));
  }

 private:
  /// Whether for a while much of it was found where nothing was before or after.
  bool appears() const {
    const auto& seen = track_.observations;
    float share = 0;
    std::size_t first = 0;
    for (std::size_t k = 0; k < seen.size(); ++k) {
      share += seen[k].free_area / seen[k].area;
      while (times_[seen[k].sweep] - times_[seen[first].sweep] > kFreeWindow + kTimeTolerance)
        share -= seen[first].free_area / seen[first].area, ++first;
      const auto count = float(k + 1 - first);
      if (times_[seen[k].sweep] - times_[seen[first].sweep] >= kFreeWindow / 2 &&
          share >= kMeanFreeShare * count && int(count) >= p_.min_detections)
        return true;
    }
    return false;
  }

  bool lies_there(const Detection& object, double time, float margin) const {
    if (!(p_.window > 0)) return false;
    const OrientedBox box = path_.box(time);
    const auto inside = [&](const Vector& p) { return box.holds(p, margin); };
    const float bottom = box.middle().z() - box.half.z();
    return object.box.high.z() >= bottom + kMinTrackedHeight &&
           std::all_of(object.samples().begin(), object.samples().end(), inside);
  }

  /// Whether the place of a detection was free before or after: by its own votes, or as it was
  /// occupied only while the object stood there, which came or left. In a queue other vehicles
  /// stood there before or after.
  bool was_free(const Detection& object, double time) {
    if (object.was_free()) return true;
    const Stay& stay = stay_at(path_.pose(time).translation());
    const bool free = stay.free_share >= kFreeEdges &&
                      (seen_to_move() ? stay.free : stay.half_free) >= p_.min_detections;
    const bool came = is_vehicle(path_) && seen_to_move();
    if (!free && !came) return false;
    return (object.first_occupied >= stay.first ||
            (came && is_of_another(object, object.first_occupied))) &&
           (object.last_occupied <= stay.last ||
            (came && is_of_another(object, object.last_occupied)));
  }

  /// Whether much of the place of a detection belongs to another vehicle that moves, in a sweep.
  bool is_of_another(const Detection& object, std::int32_t sweep) const {
    const auto& samples = object.samples();
    const auto& boxes = tracked_[std::size_t(sweep)].boxes;
    return std::any_of(boxes.begin(), boxes.end(), [&](const TrackBox& other) {
      const auto inside = [&](const Vector& p) { return other.box.holds(p, kSearchMargin); };
      return other.track != number_ && 2 * other.box.half.head<2>().maxCoeff() >= kMinRigidWidth &&
             std::count_if(samples.begin(), samples.end(), inside) >=
                 kQueueShare * float(samples.size());
    });
  }

  /// The sweeps while the object covered half of a place, to the ends of the drive if it is there
  /// at these.
  struct Stay {
    Eigen::Vector3d place;
    int first, last;
    int half_free = 0,
        free = 0;          ///< observations that show that the place was free before or after
    float free_share = 0;  ///< in the mean
  };

  const Stay& stay_at(const Eigen::Vector3d& place) {
    for (const Stay& stay : stays_)
      if ((stay.place - place).norm() <= kSamePlace / 2) return stay;
    Stay stay{place, int(times_.size()), -1};
    int count = 0;
    const float half = path_.extent().size().head<2>().norm() / 2;
    const auto& seen = track_.observations;
    const auto distance = [&](const TrackObservation& at) {
      return (path_.pose(times_[at.sweep]).translation() - place).norm();
    };
    for (const TrackObservation& at : seen) {
      if (distance(at) <= kSamePlace) {
        const float share = at.free_area / at.area;
        stay.half_free += at.is_passing();
        stay.free += share >= kFreeEdges, stay.free_share += share, ++count;
      }
      if (distance(at) > std::max(half, kSamePlace)) continue;
      stay.first = std::min(stay.first, int(at.sweep));
      stay.last = std::max(stay.last, int(at.sweep));
    }
    const auto distance_at = [&](double time) {
      return (path_.pose(time).translation() - place).norm();
    };
    if (distance_at(first_known_) <= kSamePlace) stay.first = 0;
    if (distance_at(last_known_) <= kSamePlace) stay.last = int(times_.size());
    stay.free_share /= float(std::max(count, 1));
    stays_.push_back(stay);
    return stays_.back();
  }

  const Track& track_;
  const TrackPath& path_;
  const std::uint32_t number_;
  const std::vector<double>& times_;
  const TrackParameters& p_;
  const std::vector<TrackedSweep>& tracked_;
  std::deque<Stay> stays_;
  float supported_ = 0;  ///< area of static points that the track can make dynamic
  double first_known_ = 0,
         last_known_ = 0;  ///< when its place is known for the first and last time
};

using Boxes = std::vector<std::pair<std::size_t, TrackBox>>;  ///< by sweep
using Members = std::vector<std::pair<std::size_t, Member>>;  ///< by sweep

/// Where the object of a track that moves is in the sweeps in which that is known.
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

/// The detections that belong to a track.
Members members_of(TrackEvidence& evidence, const Track& track, bool moves, std::uint32_t number,
                   const std::vector<const Detections*>& detections,
                   const std::vector<double>& times) {
  Members members;
  std::size_t first = track.observations.front().sweep, last = track.observations.back().sweep;
  while (moves && first > 0 && evidence.covers(times[first - 1])) --first;
  while (moves && last + 1 < times.size() && evidence.covers(times[last + 1])) ++last;
  auto seen = track.observations.begin();
  for (std::size_t i = first; i <= last; ++i) {
    while (seen != track.observations.end() && seen->sweep < i) ++seen;
    const bool is_seen = seen != track.observations.end() && seen->sweep == i;
    if (!is_seen && (!moves || !evidence.covers(times[i]))) continue;
    const Detections& objects = *detections[i];
    for (std::uint32_t k = 0; k < objects.size(); ++k) {
      const bool is_member = is_seen && std::find(seen->objects.begin(), seen->objects.end(), k) !=
                                            seen->objects.end();
      const bool claimed = moves && evidence.claims(i, objects[k], is_member);
      if (is_member || claimed) members.push_back({i, {objects[k].first, number, claimed}});
    }
  }
  return members;
}

TrackedObject object_of(const Track& track, const TrackPath& path,
                        const std::vector<const Detections*>& detections,
                        const std::vector<double>& times) {
  const Extent& extent = path.extent();
  const Vector middle = 0.5f * (extent.low + extent.high);
  TrackedObject object{{}, extent.size(), path.is_rigid()};
  for (std::size_t n = 0; n < track.observations.size(); ++n) {
    const TrackObservation& seen = track.observations[n];
    Pose T = path.pose(times[seen.sweep]);
    T.translate(Vector(middle.x(), middle.y(), extent.low.z()).cast<double>());
    std::uint32_t points = 0;
    for (const auto k : seen.objects) points += (*detections[seen.sweep])[k].points;
    object.places.push_back({std::uint32_t(seen.sweep), points, T, path.velocity(times[seen.sweep]),
                             path.deviation(n)});
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

/// A track and where its object is.
struct TrackAndPath {
  TrackAndPath(Track of, const std::vector<const Detections*>& detections,
               const std::vector<double>& times, const TrackParameters& p)
      : track(std::move(of)), path(track, detections, times, p) {}
  TrackAndPath(const TrackAndPath&) = delete;  // the path refers to the track
  TrackAndPath& operator=(const TrackAndPath&) = delete;

  Track track;
  TrackPath path;
};

using Paths = std::vector<std::unique_ptr<const TrackAndPath>>;

/// Tracks with enough dynamic observations, cut where their surfaces say that they went on with
/// another object.
Paths single_objects(std::vector<Track> tracks, const std::vector<const Detections*>& detections,
                     const std::vector<double>& times, const TrackParameters& p, int threads) {
  std::vector<Paths> parts(tracks.size());
  parallel_for(tracks.size(), 1, threads, [&](std::size_t k, std::size_t) {
    std::vector<Track> open{std::move(tracks[k])};
    while (!open.empty()) {
      Track next = std::move(open.back());
      open.pop_back();
      if (next.dynamic < p.min_detections) continue;
      auto part = std::make_unique<const TrackAndPath>(std::move(next), detections, times, p);
      const auto& [track, path] = *part;
      if (path.is_one_object()) {
        parts[k].push_back(std::move(part));
        continue;
      }
      // In order of time: the earliest part is taken out first.
      const std::size_t count = track.observations.size();
      if (path.end() < count) open.push_back(part_of(track, path.end(), count));
      open.push_back(part_of(track, path.begin(), path.end()));
      if (path.begin() > 0) open.push_back(part_of(track, 0, path.begin()));
    }
  });
  Paths single;
  for (Paths& of : parts)
    for (auto& part : of) single.push_back(std::move(part));
  return single;
}

}  // namespace

bool TrackedSweep::claims(std::uint32_t first) const {
  const auto before = [](const Member& member, std::uint32_t row) { return member.first < row; };
  auto member = std::lower_bound(members.begin(), members.end(), first, before);
  for (; member != members.end() && member->first == first; ++member)
    if (member->dynamic) return true;
  return false;
}

TrackingResult track_objects(const std::vector<const Detections*>& detections,
                             const std::vector<double>& times, const TrackParameters& p,
                             int threads) {
  const Paths followed =
      single_objects(follow_objects(detections, times, p), detections, times, p, threads);
  TrackingResult result;
  result.sweeps.resize(times.size());
  result.objects.resize(followed.size());
  std::vector<std::unique_ptr<TrackEvidence>> evidence(followed.size());
  std::vector<std::uint8_t> moves(followed.size());
  std::vector<Boxes> boxes(followed.size());
  std::vector<Members> members(followed.size());
  parallel_for(followed.size(), 1, threads, [&](std::size_t k, std::size_t) {
    const auto& [track, path] = *followed[k];
    const auto number = std::uint32_t(k + 1);
    evidence[k] = std::make_unique<TrackEvidence>(track, path, number, times, p, result.sweeps);
    moves[k] = evidence[k]->moves();
    if (moves[k] && p.window > 0) boxes[k] = boxes_of(track, path, number, times);
    result.objects[k] = object_of(track, path, detections, times);
  });
  for (const Boxes& of : boxes)
    for (const auto& [sweep, box] : of) result.sweeps[sweep].boxes.push_back(box);
  parallel_for(followed.size(), 1, threads, [&](std::size_t k, std::size_t) {
    members[k] = members_of(*evidence[k], followed[k]->track, moves[k], std::uint32_t(k + 1),
                            detections, times);
  });
  for (const Members& of : members)
    for (const auto& [sweep, member] : of) result.sweeps[sweep].members.push_back(member);
  for (TrackedSweep& sweep : result.sweeps)
    std::stable_sort(sweep.members.begin(), sweep.members.end(),
                     [](const Member& a, const Member& b) { return a.first < b.first; });
  auto voxels = dynamic_voxels(detections, times, result.sweeps, p.window, threads);
  for (std::size_t i = 0; i < times.size(); ++i) result.sweeps[i].voxels = std::move(voxels[i]);
  return result;
}

}  // namespace docdepth
