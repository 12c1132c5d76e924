// What a track says about the detections of any sweep.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <deque>
#include <optional>
#include <utility>
#include <vector>

#include "docdepth/detections/constants.hpp"
#include "docdepth/evidence/followed.hpp"
#include "docdepth/evidence/track_objects.hpp"
#include "docdepth/tracking/neighbors.hpp"

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
        is_vehicle_((is_vehicle(path_) && path_.passes_wide()) || is_side_of_vehicle(followed)) {
    float total = 0;
    for (const TrackObservation& seen : track_.observations) {
      total += seen.passing_area;
      supported_ = std::max(supported_, seen.passing_area);
    }
    // Of a vehicle each sweep may show another part, of a person each shows about half.
    if (is_vehicle_) supported_ = std::max(supported_, total / kTotalSupportDivisor);
    const auto is_unsure = [&](std::size_t k) { return path_.deviation(k) > kSamePlace; };
    std::size_t first = 0, end = track_.observations.size();
    while (first < end && is_unsure(first)) ++first;
    while (first < end && is_unsure(end - 1)) --end;
    is_known_ = first < end;
    if (is_known_) first_ = place_of(first), last_ = place_of(end - 1);
  }

  /// Whether it stands when it is first or last seen, so that it was or stays there.
  bool stands_before() const { return is_known_ && path_.speed(first_.time) < kStanding; }
  bool stands_after() const { return is_known_ && path_.speed(last_.time) < kStanding; }

  /// Whether it is known where the object is: it stays where it stands when it is last seen.
  bool covers(double time) const {
    return path_.covers(time) || (time < first_.time && stands_before()) ||
           (time > last_.time && stands_after());
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
    if (!is_known_) return is_member && object.was_free();
    // Before and after the places that are known the object stands at the first or the last of
    // them. A track that is lost may go on with something else, elsewhere.
    const bool is_elsewhere =
        (times_[sweep] < first_.time && !object.box.overlaps(first_.extent, 0)) ||
        (times_[sweep] > last_.time && !object.box.overlaps(last_.extent, 0));
    if (is_elsewhere) return is_member && object.was_free();
    const double time = std::clamp(times_[sweep], first_.time, last_.time);
    if (is_member) return was_free(object, time);
    if (!lies_there(object, time, kSearchMargin) || !was_free(object, time)) return false;
    // Before it is first seen, and after it is last seen, something else may stand there.
    if (time != times_[sweep] &&
        was_less_free(object, stay_at(path_.pose(time).translation()).free_share))
      return false;
    if (object.free_area >= kFreeEdges * object.area) return true;
    // Beside where it only passes, and where it is not seen any more, something else may stand.
    if (!path_.covers(times_[sweep])) return false;
    return path_.speed(time) < kSlow ||
           (path_.is_rigid() && lies_there(object, time, kObjectMargin));
  }

  /// Whether a detection of a sweep is none of the object of which another one shows most: less of
  /// its place was free before or after, and both together are wider than any vehicle. So a parked
  /// car beside one that arrives stays static, though both looked like one object far away.
  bool are_apart(std::size_t sweep, const Detection& object, const Detection& best) const {
    if (!was_less_free(object, best.passing_share())) return false;
    const Vector across = path_.pose(times_[sweep]).linear().col(1).cast<float>();
    float low = INFINITY, high = -INFINITY;
    for (const Detection* of : {&object, &best})
      for (const Vector& p : of->samples())
        low = std::min(low, across.dot(p)), high = std::max(high, across.dot(p));
    return high - low > kMaxVehicleWidth;
  }

 private:
  /// Where it is when its place is known for the first or last time.
  struct Place {
    double time = 0, deviation = 0;  ///< [s], [m]
    Extent extent;                   ///< around all that lies in its box, and a little more
  };

  Place place_of(std::size_t observation) const {
    const double time = times_[track_.observations[observation].sweep];
    const OrientedBox box = path_.box(time);
    const Eigen::Isometry3f T = box.T_box_world.inverse();
    const Vector half = box.half.array() + (kSearchMargin + kRoundingMargin);
    const Vector reach = T.linear().cwiseAbs() * half;
    return {time, path_.deviation(observation), {T.translation() - reach, T.translation() + reach}};
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
    // Something may have hidden most of what was always there, so it is enough if a quarter of it
    // was known before the object came. Far away few rays tell that, and some are wrong: where more
    // than edges was seen free, half is needed.
    const bool was_partly_free = object.free_area >= kFreeEdges * object.area;
    const auto [since, until] = was_partly_free
                                    ? std::pair(object.first_occupied, object.last_occupied)
                                    : std::pair(object.stands_since, object.stands_until);
    const double share = was_partly_free ? 0.5 : kStandingShare;
    return (since >= first_over(object, stay, share) ||
            (came && is_of_vehicle(object, object.first_occupied))) &&
           (until <= last_over(object, stay, share) ||
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

  /// What the votes tell of the object while it is at a place.
  struct Stay {
    Eigen::Vector3d place;
    bool from_begin, to_end;  ///< of the drive: there it is when it is first or last seen
    int half_free = 0,
        free = 0;          ///< observations that show that the place was free before or after
    float free_share = 0;  ///< in the mean
  };

  const Stay& stay_at(const Eigen::Vector3d& place) {
    for (const Stay& stay : stays_)
      if ((stay.place - place).norm() <= kSamePlace / 2) return stay;
    const auto is_there = [&](const Place& known) {
      const double off = (path_.pose(known.time).translation() - place).norm();
      return off <= kSamePlace + kSureDeviations * known.deviation;
    };
    Stay stay{place, is_there(first_), is_there(last_)};
    int count = 0;
    const float half = path_.extent().size().head<2>().norm() / 2;
    for (const TrackObservation& at : track_.observations) {
      const double away = (path_.pose(times_[at.sweep]).translation() - place).norm();
      if (away > std::max(half, kSamePlace)) continue;
      const float share = at.free_area / at.area;
      stay.half_free += at.is_passing();
      stay.free += share >= kFreeEdges, stay.free_share += share, ++count;
    }
    stay.free_share /= float(std::max(count, 1));
    stays_.push_back(stay);
    return stays_.back();
  }

  /// The first and the last sweep in which it covers a share of the place of a detection.
  int first_over(const Detection& object, const Stay& stay, double share) const {
    const auto& seen = track_.observations;
    const auto lies_there = [&](const auto& at) { return lies_over(at, object, stay, share); };
    if (stay.from_begin) return 0;
    const auto it = std::find_if(seen.begin(), seen.end(), lies_there);
    return it == seen.end() ? int(times_.size()) : int(it->sweep);
  }
  int last_over(const Detection& object, const Stay& stay, double share) const {
    const auto& seen = track_.observations;
    const auto lies_there = [&](const auto& at) { return lies_over(at, object, stay, share); };
    if (stay.to_end) return int(times_.size());
    const auto it = std::find_if(seen.rbegin(), seen.rend(), lies_there);
    return it == seen.rend() ? -1 : int(it->sweep);
  }
  /// By how far it is from there, or by its box. But what is wider than a vehicle was seen together
  /// with something that stood beside it, and only its box at that time tells what it covers.
  /// Points crowd where an object is near, samples do not: half of the share is asked of them.
  bool lies_over(const TrackObservation& at, const Detection& object, const Stay& stay,
                 double share) const {
    const double time = times_[at.sweep];
    const Vector size = path_.extent().size();
    const bool is_one = size.y() <= kMaxVehicleWidth;
    const double away = (path_.pose(time).translation() - stay.place).norm();
    if (is_one && away <= std::max((1 - share) * size.head<2>().norm(), double(kSamePlace)))
      return true;
    const OrientedBox box = is_one ? path_.whole_box(time) : path_.box(time);
    const auto& samples = object.samples();
    const auto inside = [&](const Vector& p) { return box.holds(p, kSearchMargin); };
    return std::count_if(samples.begin(), samples.end(), inside) >=
           share / 2 * double(samples.size());
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
  bool is_known_ = false;
  Place first_, last_;  ///< if its place is known at all
};

}  // namespace docdepth
