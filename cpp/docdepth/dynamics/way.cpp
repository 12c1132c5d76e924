#include "docdepth/dynamics/way.hpp"

#include <algorithm>
#include <cmath>

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

constexpr float kGrowth = 1.5f, kMore = 0.5f;  ///< the same thing looks so much larger at most [m]
constexpr std::size_t kFew = 3;                ///< places before and after that tell a velocity
constexpr double kWhileStanding = 3;           ///< times the window in which its box is seen
constexpr std::size_t kInAll = 8;  ///< points that moved in all sweeps, for each that is carried
constexpr float kApart = 0.1f;     ///< farther from a box it is elsewhere [m]
constexpr float kAway = 0.7f;      ///< share of places outside of its box that are asked about
constexpr float kSame = 0.25f, kTaken = 0.4f;  ///< a place is taken by another so near [m]; share
constexpr std::size_t kEvery = 2, kWitnesses = 10;  ///< sweeps that are asked whether it was free

/// Places outside of a box, from above.
Places outside(const Places& places, const Extent& box) {
  const Extent from_above{{box.low.x(), box.low.y(), -INFINITY},
                          {box.high.x(), box.high.y(), INFINITY}};
  Places result;
  for (const Vector& p : places)
    if (!from_above.overlaps({p, p}, kApart)) result.push_back(p);
  return result;
}

/// Number of places where a sweep saw something that does not move.
float taken(const Places& places, const Detections& seen) {
  const Extent box = box_of(places);
  Places there;
  for (const Detection& object : seen) {
    if (object.moves() || !object.box.overlaps(box, kSame)) continue;
    for (const Vector& p : object.places)
      if (box.overlaps({p, p}, kSame)) there.push_back(p);
  }
  return share_found(places, Vector::Zero(), there, kSame) * float(places.size());
}

}  // namespace

bool could_be(const Extent& box, const Vector& size) {
  const Vector most = size * kGrowth + Vector::Constant(kMore);
  return (box.size().array() < most.array()).all();
}

Way::Way(std::vector<Member> members, const std::vector<double>& times, const TrackParameters& p)
    : members_(std::move(members)), times_(times), p_(p) {
  if (members_.front().sweep > members_.back().sweep)
    std::reverse(members_.begin(), members_.end());
  std::size_t in_all = 0;
  for (const Member& m : members_) {
    boxes_.push_back(speed(times_[m.sweep]) < kStanding ? box(times_[m.sweep]) : m.box);
    in_all += m.shown;
    most_ = std::max({most_, m.shown, in_all / kInAll});
  }
}

bool Way::reaches(double t) const {
  const double nearest = std::clamp(t, time(0), time(members_.size() - 1));
  return std::fabs(t - nearest) <=
         (speed(nearest) < kStanding ? p_.max_gap_standing : p_.max_gap) + 1e-3;
}

Extent Way::box(double t) const {
  const bool stands = speed(t) < kStanding;
  const Vector v = stands ? Vector::Zero() : velocity(t);
  const double window = (stands ? kWhileStanding * p_.window : p_.window) + 1e-3;
  const auto far = [&](std::size_t k) { return std::fabs(time(k) - t); };
  const auto moved = [&](std::size_t k) {
    const Vector shift = v * float(t - time(k));
    return Extent{members_[k].box.low + shift, members_[k].box.high + shift};
  };
  std::size_t nearest = 0;
  for (std::size_t k = 1; k < members_.size(); ++k)
    if (far(k) < far(nearest)) nearest = k;
  Extent box = moved(nearest);
  Vector largest = members_[nearest].box.size();
  for (std::size_t k = 0; k < members_.size(); ++k) {
    if (far(k) > window) continue;
    box.add(moved(k));
    largest = largest.cwiseMax(members_[k].box.size());
  }
  return could_be(box, largest) ? box : moved(nearest);  // or not all of them are the same thing
}

bool Way::has(std::size_t sweep, std::uint32_t object) const {
  return std::any_of(members_.begin(), members_.end(), [&](const Member& m) {
    return m.sweep == sweep &&
           std::find(m.objects.begin(), m.objects.end(), object) != m.objects.end();
  });
}

bool Way::were_free(const Places& places, std::size_t sweep,
                    const std::vector<const Detections*>& sightings) const {
  const auto distance = [&](std::size_t k) {
    const std::size_t other = members_[k].sweep;
    return other > sweep ? other - sweep : sweep - other;
  };
  const auto left = [&](std::size_t k) { return outside(places, boxes_[k]); };
  std::vector<std::size_t> away;
  for (std::size_t k = 0; k < members_.size(); ++k)
    if (float(left(k).size()) >= kAway * float(places.size())) away.push_back(k);
  std::stable_sort(away.begin(), away.end(),
                   [&](std::size_t a, std::size_t b) { return distance(a) < distance(b); });
  const std::size_t last = std::min(away.size(), kEvery * kWitnesses);
  for (std::size_t i = 0; i < last; i += kEvery)
    if (taken(left(away[i]), *sightings[members_[away[i]].sweep]) >= kTaken * float(places.size()))
      return false;
  return !away.empty();
}

/// From a few places before and after, since each sweep sees other parts of it.
Vector Way::velocity(double t) const {
  const std::size_t count = members_.size(), few = std::min(kFew, count / 2);
  std::size_t k = 0;
  while (k < count && time(k) < t) ++k;
  k = std::clamp(k, few, count - few);
  Vector way = Vector::Zero();
  double duration = 0;
  for (std::size_t i = 0; i < few; ++i) {
    way += members_[k + i].place() - members_[k - 1 - i].place();
    duration += time(k + i) - time(k - 1 - i);
  }
  return way / float(duration);
}

}  // namespace docdepth
