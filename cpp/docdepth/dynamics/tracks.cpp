#include "docdepth/dynamics/tracks.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/geometry/parallel.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Flags = std::vector<std::uint8_t>;
using Rows = std::vector<std::uint32_t>;  ///< objects of a sighting, by their number in it

constexpr std::size_t kFewestPlaces = 5;       ///< of an object that has a shape to be found by
constexpr float kLowest = 0.15f;               ///< flatter things are ground that was not grown [m]
constexpr float kThinnest = 0.3f;              ///< thinner things stand: poles, from above [m]
constexpr float kWidest = 25.0f;               ///< [m]
constexpr float kGrowth = 1.5f, kMore = 0.5f;  ///< the same thing looks so much larger at most [m]
constexpr float kMargin = 0.5f;                ///< about where it is looked for [m]
constexpr float kExplained = 0.4f;  ///< share of what is there, less when half of it is not seen
constexpr float kInside = 0.6f;     ///< share of the places of what belongs to it
constexpr std::size_t kPlaces = 100;
constexpr float kThin = 0.15f;
constexpr float kStanding = 0.5f;     ///< slower things may be hidden for long [m/s]
constexpr float kSlow = 2;            ///< key frames near in time saw it stand at its place [m/s]
constexpr float kByVotes = 0.3f;      ///< share of the way that it goes while votes say so
constexpr std::size_t kFew = 3;       ///< places before and after that tell a velocity
constexpr double kWhileStanding = 3;  ///< times the window in which its box is seen
constexpr std::size_t kInAll = 8;     ///< points that moved in all sweeps, for each that is carried
constexpr float kApart = 0.1f;        ///< farther from a box it is elsewhere [m]
constexpr float kAway = 0.7f;         ///< share of places outside of its box that are asked about
constexpr float kSame = 0.25f, kTaken = 0.4f;  ///< a place is taken by another so near [m]; share
constexpr std::size_t kEvery = 2, kWitnesses = 10;  ///< sweeps that are asked whether it was free

struct Member {
  std::size_t sweep;
  Rows objects;
  Extent box;
  std::size_t shown;  ///< points that move by the votes

  /// The middle of its box, from above.
  Vector place() const {
    const Vector middle = 0.5f * (box.low + box.high);
    return {middle.x(), middle.y(), 0};
  }
};

struct Track {
  Places places;   ///< where the last two sightings saw it: each may see another part of it
  Places last;     ///< where the last one did
  Vector largest;  ///< of the sizes of its objects
  double time;
  std::vector<Member> members;
  Vector velocity = Vector::Zero();
  int moved = 1;               ///< members that move
  std::size_t last_moved = 0;  ///< the last of them
  bool has_velocity() const { return members.size() > 1; }
};

/// Where a track goes on.
struct Match {
  float explained = 0;
  Vector shift = Vector::Zero();
  Rows objects;
  Places places;
  Extent box;
  Vector largest;
};

bool can_be_followed(const SeenObject& object) {
  return object.box.size().z() >= kLowest && object.box.width() <= kWidest;
}

/// Whether what has this box may be the same thing as what was seen with another size.
bool could_be(const Extent& box, const Vector& size) {
  const Vector most = size * kGrowth + Vector::Constant(kMore);
  return (box.size().array() < most.array()).all();
}

void append(Places& places, const Places& more) {
  places.insert(places.end(), more.begin(), more.end());
}

/// Follows objects through sightings, one after the other in time or against it.
class Follower {
 public:
  Follower(const std::vector<const Sighting*>& sightings, const std::vector<double>& times,
           const TrackParameters& p)
      : sightings_(sightings), times_(times), p_(p) {}

  std::vector<Track> run(bool backward) {
    const std::size_t count = sightings_.size();
    for (std::size_t k = 0; k < count; ++k) advance(backward ? count - 1 - k : k);
    for (Track& track : alive_) done_.push_back(std::move(track));
    return std::move(done_);
  }

 private:
  void advance(std::size_t sweep) {
    const Sighting& seen = *sightings_[sweep];
    Flags taken(seen.size());
    for (std::size_t k = 0; k < seen.size(); ++k) taken[k] = !can_be_followed(seen[k]);
    // Those known for longest choose first.
    std::stable_sort(alive_.begin(), alive_.end(), [](const Track& a, const Track& b) {
      return a.members.size() > b.members.size();
    });
    std::vector<Track> alive;
    for (Track& track : alive_) {
      const double dt = times_[sweep] - track.time;
      Match match = find(track, track.places, seen, taken, dt);
      if (match.explained == 0) match = find(track, track.last, seen, taken, dt);
      if (match.explained > 0) add(track, sweep, std::move(match), taken);
      auto& to = std::fabs(times_[sweep] - track.time) <= patience(track) ? alive : done_;
      to.push_back(std::move(track));
    }
    alive_ = std::move(alive);
    for (std::uint32_t k = 0; k < seen.size(); ++k) {
      const auto& [first, points, dynamic, box, places] = seen[k];
      if (!taken[k] && seen[k].moves() && places.size() >= kFewestPlaces)
        alive_.push_back({places, places, box.size(), times_[sweep], {{sweep, {k}, box, dynamic}}});
    }
  }

  double patience(const Track& track) const {
    const bool stands = track.has_velocity() && track.velocity.norm() < kStanding;
    return (stands && track.moved >= p_.sightings ? p_.hold : p_.gap) + 1e-3;
  }

  /// Where it is, if those are its places.
  Match find(const Track& track, const Places& places, const Sighting& seen, const Flags& taken,
             double dt) const {
    const float reach = p_.max_speed * static_cast<float>(std::fabs(dt));
    Match best;
    const auto attempt = [&](const Vector& start) {
      Match match = match_from(track, places, seen, taken, start, reach);
      if (match.explained > best.explained) best = std::move(match);
    };
    if (track.has_velocity()) {
      attempt(track.velocity * static_cast<float>(dt));
      attempt(Vector::Zero());
      return best;
    }
    const Extent box = box_of(places);
    for (std::size_t k = 0; k < seen.size(); ++k)
      if (!taken[k] && seen[k].moves() && seen[k].box.overlaps(box, reach))
        attempt(most_frequent_shift(places, seen[k].places, reach));
    return best;
  }

  /// What of the sighting falls onto the places, shifted from `start` on.
  Match match_from(const Track& track, const Places& places, const Sighting& seen,
                   const Flags& taken, const Vector& start, float reach) const {
    Extent box = box_of(places);
    const Vector size = box.size();
    box.low += start;
    box.high += start;
    Rows near;
    Places there;
    for (std::uint32_t k = 0; k < seen.size(); ++k) {
      if (taken[k] || !seen[k].box.overlaps(box, kMargin)) continue;
      if (!track.has_velocity() && !seen[k].moves()) continue;
      if (!could_be(seen[k].box, size)) continue;
      near.push_back(k);
      append(there, seen[k].places);
    }
    Match match;
    match.shift = start;
    match.largest = track.largest;
    if (!refine_shift(places, there, match.shift)) return {};
    for (const auto k : near) {
      if (share_found(seen[k].places, -match.shift, places) < kInside) continue;
      if (match.objects.empty()) match.box = seen[k].box;
      match.objects.push_back(k);
      append(match.places, seen[k].places);
      match.box.add(seen[k].box);
      match.largest = match.largest.cwiseMax(seen[k].box.size());
    }
    // What is larger than a thing of one piece is two: somebody, and what he walks away from.
    if (match.objects.empty() || !could_be(match.box, match.largest)) return {};
    const float again = std::min(1.0f, 2 * share_found(places, match.shift, match.places)),
                known = share_found(match.places, -match.shift, places);
    // Of two that fit alike the nearer is the likelier.
    match.explained = again * known / (1 + match.shift.norm() / (2 * reach));
    return match.explained >= kExplained ? match : Match{};
  }

  void add(Track& track, std::size_t sweep, Match&& match, Flags& taken) const {
    const Sighting& seen = *sightings_[sweep];
    const Vector velocity = match.shift / static_cast<float>(times_[sweep] - track.time);
    track.velocity = track.has_velocity() ? 0.5f * track.velocity + 0.5f * velocity : velocity;
    track.time = times_[sweep];
    std::uint32_t points = 0, moving = 0, shown = 0;
    for (const auto k : match.objects) {
      taken[k] = 1;
      points += seen[k].points;
      shown += seen[k].dynamic;
      if (seen[k].moves()) moving += seen[k].points;
    }
    const bool moves = 2 * moving >= points;
    track.moved += moves;
    if (moves) track.last_moved = track.members.size();
    Places both = std::move(track.last);
    for (Vector& p : both) p += match.shift;
    append(both, match.places);
    track.places = thinned(both, kThin, kPlaces);
    track.last = std::move(match.places);
    track.largest = match.largest;
    track.members.push_back({sweep, std::move(match.objects), match.box, shown});
  }

  const std::vector<const Sighting*>& sightings_;
  const std::vector<double>& times_;
  const TrackParameters& p_;
  std::vector<Track> alive_, done_;
};

bool moved(const Track& track, const TrackParameters& p) {
  const auto& m = track.members;
  const auto way = [&](const Member& to) { return (to.place() - m.front().place()).norm(); };
  return track.moved >= p.sightings && way(m.back()) >= p.distance &&
         way(m[track.last_moved]) >= kByVotes * p.distance;
}

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
float taken(const Places& places, const Sighting& seen) {
  const Extent box = box_of(places);
  Places there;
  for (const SeenObject& object : seen) {
    if (object.moves() || !object.box.overlaps(box, kSame)) continue;
    for (const Vector& p : object.places)
      if (box.overlaps({p, p}, kSame)) there.push_back(p);
  }
  return share_found(places, Vector::Zero(), there, kSame) * float(places.size());
}

/// Where a track is at any time, from its members in the order of time.
class Way {
 public:
  Way(std::vector<Member> members, const std::vector<double>& times, const TrackParameters& p)
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

  /// Whether enough of it was seen to move for all that does not move now.
  bool carries(const SeenObject& now) const { return now.points - now.dynamic <= most_; }

  /// Whether it is known where it is: a little before and after its sightings, longer if it stands.
  bool reaches(double t) const {
    const double nearest = std::clamp(t, time(0), time(members_.size() - 1));
    return std::fabs(t - nearest) <= (speed(nearest) < kStanding ? p_.hold : p_.gap) + 1e-3;
  }
  float speed(double t) const { return velocity(t).norm(); }

  /// The boxes of members that are near in time, or of the nearest one, moved along.
  Extent box(double t) const {
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

  /// Whether an object of a sweep is one of the members' own.
  bool has(std::size_t sweep, std::uint32_t object) const {
    return std::any_of(members_.begin(), members_.end(), [&](const Member& m) {
      return m.sweep == sweep &&
             std::find(m.objects.begin(), m.objects.end(), object) != m.objects.end();
    });
  }

  /// Whether places were free when it was elsewhere, as the nearest such sweeps tell.
  bool were_free(const Places& places, std::size_t sweep,
                 const std::vector<const Sighting*>& sightings) const {
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
      if (taken(left(away[i]), *sightings[members_[away[i]].sweep]) >=
          kTaken * float(places.size()))
        return false;
    return !away.empty();
  }

 private:
  double time(std::size_t k) const { return times_[members_[k].sweep]; }

  /// From a few places before and after, since each sweep sees other parts of it.
  Vector velocity(double t) const {
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

  std::vector<Member> members_;
  std::vector<Extent> boxes_;  ///< where they are, as far as known
  std::size_t most_ = 0;       ///< points that it carries
  const std::vector<double>& times_;
  const TrackParameters& p_;
};

/// Whether an object lies in the box, and is no ground at its bottom.
bool inside(const SeenObject& object, const Extent& box) {
  return (object.box.low.array() >= box.low.array() - kMargin).all() &&
         (object.box.high.array() <= box.high.array() + kMargin).all() &&
         object.box.high.z() >= box.low.z() + kLowest;
}

/// What is known of a track in a sweep.
void find(const Way& way, std::size_t sweep, double time, const Sighting& seen,
          const std::vector<const Sighting*>& sightings, const TrackParameters& p,
          Followed& found) {
  const Extent box = way.box(time);
  const float speed = way.speed(time);
  for (std::uint32_t k = 0; k < seen.size(); ++k) {
    const bool there = p.window > 0 && speed < kSlow && inside(seen[k], box);
    if (seen[k].dynamic < seen[k].points && seen[k].box.width() >= kThinnest &&
        way.carries(seen[k]) && (there || way.has(sweep, k)) &&
        way.were_free(seen[k].places, sweep, sightings))
      found.objects.push_back(seen[k].first);
  }
  if (p.window > 0 && speed >= kStanding) found.boxes.push_back(box);
}

}  // namespace

std::vector<Followed> follow(const std::vector<const Sighting*>& sightings,
                             const std::vector<double>& times, const TrackParameters& p,
                             int threads) {
  std::vector<Followed> ways[2];
  parallel_for(2, 1, threads, [&](std::size_t backward, std::size_t) {
    auto& found = ways[backward];
    found.resize(times.size());
    for (const Track& track : Follower(sightings, times, p).run(backward != 0)) {
      if (!moved(track, p)) continue;
      const Way way(track.members, times, p);
      for (std::size_t i = 0; i < times.size(); ++i)
        if (way.reaches(times[i])) find(way, i, times[i], *sightings[i], sightings, p, found[i]);
    }
  });
  std::vector<Followed> result = std::move(ways[0]);
  for (std::size_t i = 0; i < result.size(); ++i) {
    Rows& rows = result[i].objects;
    rows.insert(rows.end(), ways[1][i].objects.begin(), ways[1][i].objects.end());
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
    auto& boxes = result[i].boxes;
    boxes.insert(boxes.end(), ways[1][i].boxes.begin(), ways[1][i].boxes.end());
  }
  return result;
}

}  // namespace docdepth
