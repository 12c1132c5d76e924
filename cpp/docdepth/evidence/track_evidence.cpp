#include "docdepth/evidence/track_evidence.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "docdepth/detections/classification.hpp"
#include "docdepth/tracking/constants.hpp"
#include "docdepth/tracking/neighbors.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// Of an object that was always there edges seem free, at most this share of its area.
constexpr float kFreeEdges = 0.15f;
/// Of somebody in single file this share was found free at some time, if he lies in the box of his
/// track: the first and the last sweeps see less than half.
constexpr float kPersonFreeShare = 0.35f;

}  // namespace

TrackEvidence::TrackEvidence(ObjectTrack object, std::uint32_t number,
                             const std::vector<double>& times, const TrackingOptions& options)
    : object_(std::move(object)),
      number_(number),
      options_(options),
      sweeps_(int(times.size())),
      drives_far_(drives_far(object_.path)),
      is_vehicle_(is_vehicle(object_.path) && object_.path.is_wide_while_transient()) {
  const auto& observations = object_.track.observations;
  for (const TrackObservation& seen : observations) {
    stamps_.push_back(times[seen.sweep]);
    // Of a vehicle each sweep may show another part, of a person each shows about half.
    const float free = seen.found_free_area();
    supported_ = is_vehicle_ ? supported_ + free : std::max(supported_, free);
  }
  seen_to_move_ = is_seen_to_move();
  const auto is_unsure = [&](std::size_t k) { return object_.path.deviation(k) > kSamePlace; };
  std::size_t first = 0, end = observations.size();
  while (first < end && is_unsure(first)) ++first;
  while (first < end && is_unsure(end - 1)) --end;
  is_known_ = first < end;
  if (!is_known_) return;
  first_ = place_of(first);
  last_ = place_of(end - 1);
}

bool TrackEvidence::stands_before() const {
  return is_known_ && object_.path.speed(first_.time) < kStanding;
}

bool TrackEvidence::stands_after() const {
  return is_known_ && object_.path.speed(last_.time) < kStanding;
}

bool TrackEvidence::covers(double time) const {
  return object_.path.covers(time) || (time < first_.time && stands_before()) ||
         (time > last_.time && stands_after());
}

std::optional<Extent> TrackEvidence::reach(double time) const {
  if (!is_known_) return std::nullopt;
  const double known = std::clamp(time, first_.time, last_.time);
  return object_.path.box(known).extent(kSearchMargin);
}

/// Whether it moved while the votes called it dynamic.
bool TrackEvidence::is_seen_to_move() const {
  const auto& observations = object_.track.observations;
  std::optional<Eigen::Vector2d> first;
  double most = 0;
  for (std::size_t n = 0; n < observations.size(); ++n) {
    if (!observations[n].is_dynamic) continue;
    const Eigen::Vector2d place = object_.path.pose(stamps_[n]).translation().head<2>();
    if (!first) first = place;
    most = std::max(most, (place - *first).norm());
  }
  return most >= options_.min_distance;
}

bool TrackEvidence::makes_dynamic(double time, const Detection& object, bool is_member) {
  if (object.dynamic_points == object.points) return false;
  if (object.area - object.dynamic_area > supported_) return false;
  if (!is_known_) return is_member && object.was_free();
  // Before and after the places that are known the object stands at the first or the last of them.
  // A track that is lost may go on with something else, elsewhere.
  const bool is_elsewhere = (time < first_.time && !object.box.overlaps(first_.extent, 0)) ||
                            (time > last_.time && !object.box.overlaps(last_.extent, 0));
  if (is_elsewhere) return is_member && object.was_free();
  const double known = std::clamp(time, first_.time, last_.time);
  const bool goes = is_member && goes_through(object, time);
  if (known == time && (goes || drives_over(object, time))) return true;
  if (is_member) return was_free(object, known);
  if (!lies_there(object, known, kSearchMargin) || !was_free(object, known)) return false;
  // Before it is first seen, and after it is last seen, something else may stand there.
  if (known != time &&
      was_less_free(object, occupancy_at(object_.path.pose(known).translation()).free_share))
    return false;
  if (object.free_area >= kFreeEdges * object.area) return true;
  // Beside where it only passes, and where it is not seen any more, something else may stand.
  if (!object_.path.covers(time)) return false;
  return object_.path.speed(known) < kSlow ||
         (object_.path.is_rigid() && lies_there(object, known, kObjectMargin));
}

bool TrackEvidence::are_apart(double time, const Detection& object, const Detection& best) const {
  if (!was_less_free(object, best.transient_share())) return false;
  const Vector across = object_.path.pose(time).linear().col(1).cast<float>();
  float low = INFINITY, high = -INFINITY;
  for (const Detection* of : {&object, &best})
    for (const Vector& p : of->samples()) {
      low = std::min(low, across.dot(p));
      high = std::max(high, across.dot(p));
    }
  return high - low > kMaxVehicleWidth;
}

TrackEvidence::KnownPlace TrackEvidence::place_of(std::size_t observation) const {
  return {.time = stamps_[observation],
          .extent = object_.path.box(stamps_[observation]).extent(kSearchMargin)};
}

bool TrackEvidence::lies_there(const Detection& object, double time, float margin) const {
  if (!(options_.window > 0)) return false;
  const OrientedBox box = object_.path.box(time);
  const auto inside = [&](const Vector& p) { return box.contains(p, margin); };
  const float bottom = box.middle().z() - box.half.z();
  return object.box.high.z() >= bottom + kMinTrackedHeight &&
         std::all_of(object.samples().begin(), object.samples().end(), inside);
}

/// Whether a detection lies where the track drives. Nothing that stands can be there, also where
/// lorries that follow each other have hidden that the place was free.
bool TrackEvidence::drives_over(const Detection& object, double time) const {
  return drives_far_ && object_.path.speed(time) >= kSlow &&
         lies_there(object, time, kObjectMargin);
}

/// Whether the object moves where much of a detection was found free. Where people walk in single
/// file, as many key frames find the place of each occupied as free.
bool TrackEvidence::goes_through(const Detection& object, double time) const {
  const bool in_file = !object_.path.is_rigid() && lies_there(object, time, kObjectMargin);
  const float share = in_file ? kPersonFreeShare : kMinFreeShare;
  return object_.path.speed(time) >= kStanding && object.found_free_area() >= share * object.area;
}

/// Whether the place of a detection was free before or after: by its own votes, or as it was
/// occupied only while the object stood there, which came or left.
bool TrackEvidence::was_free(const Detection& object, double time) {
  if (object.was_free()) return true;
  // Where a person stops, some of his place was seen free before. A bin beside him was not, though
  // a narrow view may see it only from then on.
  const bool was_partly_free = object.free_area >= kFreeEdges * object.area;
  if (!is_vehicle_ && !was_partly_free) return false;
  const Occupancy& occupancy = occupancy_at(object_.path.pose(time).translation());
  const int count = seen_to_move_ ? occupancy.free_count : occupancy.transient_count;
  const bool free = occupancy.free_share >= kFreeEdges && count >= options_.min_detections;
  if (!free && !(is_vehicle_ && seen_to_move_)) return false;
  // Something may have hidden most of what was always there, so it is enough if a quarter of it was
  // known before the object came. Far away few rays tell that, and some are wrong: where more than
  // edges was seen free, half is needed.
  const auto [since, until] = was_partly_free
                                  ? std::pair(object.first_occupied, object.last_occupied)
                                  : std::pair(object.stands_since, object.stands_until);
  const double share = was_partly_free ? 0.5 : kStandingShare;
  return since >= first_over(object, occupancy, share) &&
         until <= last_over(object, occupancy, share);
}

const TrackEvidence::Occupancy& TrackEvidence::occupancy_at(const Eigen::Vector3d& place) {
  for (const Occupancy& occupancy : occupancies_)
    if ((occupancy.place - place).norm() <= kSamePlace / 2) return occupancy;
  const auto is_there = [&](const KnownPlace& known) {
    return (object_.path.pose(known.time).translation() - place).norm() <= kSamePlace;
  };
  Occupancy occupancy{.place = place, .from_begin = is_there(first_), .to_end = is_there(last_)};
  int count = 0;
  const float half = object_.path.extent().size().head<2>().norm() / 2;
  const auto& observations = object_.track.observations;
  for (std::size_t n = 0; n < observations.size(); ++n) {
    const double away = (object_.path.pose(stamps_[n]).translation() - place).norm();
    if (away > std::max(half, kSamePlace)) continue;
    const float share = observations[n].free_area / observations[n].area;
    occupancy.transient_count += observations[n].is_mostly_transient();
    occupancy.free_count += share >= kFreeEdges;
    occupancy.free_share += share;
    ++count;
  }
  occupancy.free_share /= float(std::max(count, 1));
  occupancies_.push_back(occupancy);
  return occupancies_.back();
}

/// The first sweep in which it covers a share of the place of a detection.
int TrackEvidence::first_over(const Detection& object, const Occupancy& occupancy,
                              double share) const {
  if (occupancy.from_begin) return 0;
  const auto& observations = object_.track.observations;
  for (std::size_t n = 0; n < observations.size(); ++n)
    if (lies_over(n, object, share)) return int(observations[n].sweep);
  return sweeps_;
}

/// The last one.
int TrackEvidence::last_over(const Detection& object, const Occupancy& occupancy,
                             double share) const {
  if (occupancy.to_end) return sweeps_;
  const auto& observations = object_.track.observations;
  for (std::size_t n = observations.size(); n-- > 0;)
    if (lies_over(n, object, share)) return int(observations[n].sweep);
  return -1;
}

/// What is wider than a vehicle was seen together with something that stood beside it, and only its
/// box at that time tells what it covers. Points crowd where an object is near, samples do not:
/// half of the share is asked of them.
bool TrackEvidence::lies_over(std::size_t observation, const Detection& object,
                              double share) const {
  const double time = stamps_[observation];
  const bool is_one = object_.path.extent().size().y() <= kMaxVehicleWidth;
  const OrientedBox box = is_one ? object_.path.whole_box(time) : object_.path.box(time);
  const auto& samples = object.samples();
  const auto inside = [&](const Vector& p) { return box.contains(p, kSearchMargin); };
  return std::count_if(samples.begin(), samples.end(), inside) >=
         share / 2 * double(samples.size());
}

}  // namespace docdepth
