// What a track says about the detections of any sweep.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "docdepth/objects/constants.hpp"
#include "docdepth/objects/followed.hpp"
#include "docdepth/objects/tracking.hpp"

namespace docdepth {

/// What an object that moves at some time says about detections, by its track and path.
class TrackEvidence {
  using Vector = Eigen::Vector3f;

 public:
  /// @param tracked  with the boxes of all tracks
  TrackEvidence(const TrackAndPath& followed, std::uint32_t number,
                const std::vector<double>& times, const TrackParameters& p,
                const std::vector<TrackedSweep>& tracked)
      : track_(followed.track),
        path_(followed.path),
        number_(number),
        times_(times),
        p_(p),
        tracked_(tracked),
        is_rail_(is_rail(followed)),
        is_vehicle_(is_vehicle(path_) || is_side_of_vehicle(followed)) {
    float total = 0;
    for (const TrackObservation& seen : track_.observations) {
      total += seen.passing_area;
      supported_ = std::max({supported_, seen.passing_area, total / kTotalSupportDivisor});
    }
    std::size_t first = 0, last = track_.observations.size() - 1;
    while (first < last && path_.deviation(first) > kSamePlace) ++first;
    while (first < last && path_.deviation(last) > kSamePlace) --last;
    first_known_ = times[track_.observations[first].sweep];
    last_known_ = times[track_.observations[last].sweep];
    first_place_ = place_at(first_known_), last_place_ = place_at(last_known_);
  }

  /// Whether it stands when it is first or last seen, so that it was or stays there.
  bool stands_before() const { return path_.speed(first_known_) < kStanding; }
  bool stands_after() const { return path_.speed(last_known_) < kStanding; }

  /// Whether it is known where the object is: it stays where it stands when it is last seen.
  bool covers(double time) const {
    return path_.covers(time) || (time < first_known_ && stands_before()) ||
           (time > last_known_ && stands_after());
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
    if (is_rail_) return false;
    if (object.dynamic == object.points || object.box.width() < kMinTrackedWidth) return false;
    if (object.area - object.dynamic_area > supported_) return false;
    // What has come to stand is asked about each sweep of the rest of the drive.
    if (!is_member && ((times_[sweep] < first_known_ && !object.box.overlaps(first_place_, 0)) ||
                       (times_[sweep] > last_known_ && !object.box.overlaps(last_place_, 0))))
      return false;
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
  /// Around all that lies in its box at a time, and a little more.
  Extent place_at(double time) const {
    const OrientedBox box = path_.box(time);
    const Eigen::Isometry3f T = box.T_box_world.inverse();
    const Vector half = box.half.array() + (kSearchMargin + kRoundingMargin);
    const Vector reach = T.linear().cwiseAbs() * half;
    return {T.translation() - reach, T.translation() + reach};
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
    // Where a person stops, some of his place was seen free before. A bin beside him was not,
    // though a narrow view may see it only from then on.
    if (!is_vehicle_ && object.free_area < kFreeEdges * object.area) return false;
    const Stay& stay = stay_at(path_.pose(time).translation());
    const bool free = stay.free_share >= kFreeEdges &&
                      (seen_to_move() ? stay.free : stay.half_free) >= p_.min_detections;
    const bool came = is_vehicle_ && seen_to_move();
    if (!free && !came) return false;
    return (object.first_occupied >= stay.first ||
            (came && is_of_vehicle(object, object.first_occupied))) &&
           (object.last_occupied <= stay.last ||
            (came && is_of_vehicle(object, object.last_occupied)));
  }

  /// Whether much of the place of a detection belongs to a vehicle that moves, in a sweep: another
  /// one, or the front of this one, if it is long.
  bool is_of_vehicle(const Detection& object, std::int32_t sweep) const {
    const auto& samples = object.samples();
    const auto& boxes = tracked_[std::size_t(sweep)].boxes;
    const bool is_long = path_.extent().size().x() >= kMinLongVehicle;
    return std::any_of(boxes.begin(), boxes.end(), [&](const TrackBox& of) {
      const auto inside = [&](const Vector& p) { return of.box.holds(p, kSearchMargin); };
      return (is_long || of.track != number_) &&
             2 * of.box.half.head<2>().maxCoeff() >= kMinRigidWidth &&
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
      if (distance(at) > std::max(half, kSamePlace)) continue;
      const float share = at.free_area / at.area;
      stay.half_free += at.is_passing();
      stay.free += share >= kFreeEdges, stay.free_share += share, ++count;
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
  const bool is_rail_, is_vehicle_;  ///< or only the side of one is seen
  std::deque<Stay> stays_;
  float supported_ = 0;  ///< area of static points that the track can make dynamic
  double first_known_ = 0,
         last_known_ = 0;            ///< when its place is known for the first and last time
  Extent first_place_, last_place_;  ///< where it is then
};

}  // namespace docdepth
