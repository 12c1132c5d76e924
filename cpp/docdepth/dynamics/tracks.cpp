#include "docdepth/dynamics/tracks.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <numeric>

#include "docdepth/geometry/parallel.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Flags = std::vector<std::uint8_t>;
using Rows = std::vector<std::uint32_t>;  ///< objects of a sighting, by their number in it

constexpr std::uint32_t kFewestPoints = 10;    ///< of an object that is worth to be followed,
constexpr std::size_t kFewestPlaces = 5;       ///< which has a shape to be found by
constexpr float kLowest = 0.3f;                ///< flatter things are ground that was not grown [m]
constexpr float kWidest = 25.0f;               ///< [m]
constexpr float kGrowth = 1.5f, kMore = 0.5f;  ///< the same thing looks so much larger at most [m]
constexpr float kMargin = 0.5f;                ///< about where it is looked for [m]
constexpr float kExplained = 0.4f;  ///< share of places found again, of one times the other
constexpr float kInside = 0.6f;     ///< share of the places of what belongs to it
constexpr std::size_t kPlaces = 100;
constexpr float kThin = 0.15f;
constexpr float kStanding = 0.5f;   ///< slower things may be hidden for long [m/s]
constexpr double kSpeedOver = 0.3;  ///< time before and after over which a speed is taken [s]
constexpr std::size_t kLast = 4;    ///< sightings that tell how a way goes on
constexpr float kApart = 0.1f;      ///< boxes that far apart: it has left [m]
constexpr float kSame = 0.25f;      ///< a place is taken when another one is that near [m]
constexpr float kTaken = 0.4f;      ///< share of taken places
constexpr std::size_t kEvery = 5, kWitnesses = 4;  ///< sweeps that are asked whether it was free

struct Member {
  std::size_t sweep;
  Rows objects;
  bool moves;  ///< by the votes on that sweep
  Extent box;

  /// The middle of its box, from above.
  Vector place() const {
    const Vector middle = 0.5f * (box.low + box.high);
    return {middle.x(), middle.y(), 0};
  }
};

struct Track {
  Places places;  ///< when it was last seen
  double time;
  Vector velocity = Vector::Zero();
  std::vector<Member> members;
  int moved = 0;  ///< members that move

  bool has_velocity() const { return members.size() > 1; }
};

/// Where a track goes on.
struct Match {
  float explained = 0;
  Vector shift = Vector::Zero();
  Rows objects;
  Places places;
};

Extent box_of(const Places& places) {
  Extent box{places.front(), places.front()};
  for (const Vector& p : places) box.add({p, p});
  return box;
}

bool can_be_followed(const SeenObject& object) {
  return object.box.size().z() >= kLowest && object.box.width() <= kWidest;
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
      Match match = find(track, seen, taken, times_[sweep] - track.time);
      if (match.explained > 0) add(track, sweep, std::move(match), taken);
      auto& to = std::fabs(times_[sweep] - track.time) <= patience(track) ? alive : done_;
      to.push_back(std::move(track));
    }
    alive_ = std::move(alive);
    for (std::uint32_t k = 0; k < seen.size(); ++k)
      if (!taken[k] && seen[k].moves() && seen[k].points >= kFewestPoints &&
          seen[k].places.size() >= kFewestPlaces)
        alive_.push_back(
            {seen[k].places, times_[sweep], Vector::Zero(), {{sweep, {k}, true, seen[k].box}}, 1});
  }

  double patience(const Track& track) const {
    const bool stands = track.has_velocity() && track.velocity.norm() < kStanding;
    return (stands && track.moved >= p_.sightings ? p_.hold : p_.gap) + 1e-3;
  }

  Match find(const Track& track, const Sighting& seen, const Flags& taken, double dt) const {
    const float reach = p_.max_speed * static_cast<float>(std::fabs(dt));
    Match best;
    const auto attempt = [&](const Vector& start) {
      Match match = match_from(track, seen, taken, start, reach);
      if (match.explained > best.explained) best = std::move(match);
    };
    if (track.has_velocity()) {
      attempt(track.velocity * static_cast<float>(dt));
      attempt(Vector::Zero());
      return best;
    }
    const Extent box = box_of(track.places);
    for (std::size_t k = 0; k < seen.size(); ++k)
      if (!taken[k] && seen[k].moves() && seen[k].box.overlaps(box, reach))
        attempt(most_frequent_shift(track.places, seen[k].places, reach));
    return best;
  }

  /// What of the sighting falls onto the track's places, shifted from `start` on.
  Match match_from(const Track& track, const Sighting& seen, const Flags& taken,
                   const Vector& start, float reach) const {
    Extent box = box_of(track.places);
    const Vector most = box.size() * kGrowth + Vector::Constant(kMore);
    box.low += start;
    box.high += start;
    Rows near;
    Places there;
    for (std::uint32_t k = 0; k < seen.size(); ++k) {
      if (taken[k] || !seen[k].box.overlaps(box, kMargin)) continue;
      if (!track.has_velocity() && !seen[k].moves()) continue;
      if ((seen[k].box.size().array() >= most.array()).any()) continue;
      near.push_back(k);
      append(there, seen[k].places);
    }
    Match match;
    match.shift = start;
    if (!refine_shift(track.places, there, match.shift)) return {};
    for (const auto k : near) {
      if (share_found(seen[k].places, -match.shift, track.places) < kInside) continue;
      match.objects.push_back(k);
      append(match.places, seen[k].places);
    }
    if (match.objects.empty()) return {};
    const float both = share_found(track.places, match.shift, match.places) *
                       share_found(match.places, -match.shift, track.places);
    // Of two that fit alike the nearer is the likelier.
    match.explained = both / (1 + match.shift.norm() / (2 * reach));
    return match.explained >= kExplained ? match : Match{};
  }

  void add(Track& track, std::size_t sweep, Match&& match, Flags& taken) const {
    const Sighting& seen = *sightings_[sweep];
    const Vector velocity = match.shift / static_cast<float>(times_[sweep] - track.time);
    track.velocity = track.has_velocity() ? 0.5f * track.velocity + 0.5f * velocity : velocity;
    track.time = times_[sweep];
    Extent box = seen[match.objects.front()].box;
    std::uint32_t points = 0, moving = 0;
    for (const auto k : match.objects) {
      taken[k] = 1;
      box.add(seen[k].box);
      points += seen[k].points;
      if (seen[k].moves()) moving += seen[k].points;
    }
    const bool moves = 2 * moving >= points;
    track.moved += moves;
    track.places = thinned(match.places, kThin, kPlaces);
    track.members.push_back({sweep, std::move(match.objects), moves, box});
  }

  const std::vector<const Sighting*>& sightings_;
  const std::vector<double>& times_;
  const TrackParameters& p_;
  std::vector<Track> alive_, done_;
};

bool moved(const Track& track, const TrackParameters& p) {
  const Vector way = track.members.back().place() - track.members.front().place();
  return track.moved >= p.sightings && way.norm() >= p.distance;
}

/// Share of the places where a sweep saw something that does not move.
float share_taken(const Places& places, const Sighting& seen) {
  const Extent box = box_of(places);
  Places there;
  for (const SeenObject& object : seen) {
    if (object.moves() || !object.box.overlaps(box, kSame)) continue;
    for (const Vector& p : object.places)
      if (box.overlaps({p, p}, kSame)) there.push_back(p);
  }
  return share_found(places, Vector::Zero(), there, kSame);
}

/// Some members of the track that were elsewhere, the nearest in time first.
std::vector<std::size_t> witnesses(const Track& track, const Member& member) {
  std::vector<std::size_t> away;
  for (const Member& other : track.members) {
    const auto apart = [&](int axis) {
      return other.box.low[axis] > member.box.high[axis] + kApart ||
             other.box.high[axis] < member.box.low[axis] - kApart;
    };
    if (apart(0) || apart(1)) away.push_back(other.sweep);
  }
  const auto distance = [&](std::size_t sweep) {
    return sweep > member.sweep ? sweep - member.sweep : member.sweep - sweep;
  };
  std::stable_sort(away.begin(), away.end(),
                   [&](std::size_t a, std::size_t b) { return distance(a) < distance(b); });
  std::vector<std::size_t> chosen;
  for (std::size_t k = 0; k < away.size() && chosen.size() < kWitnesses; k += kEvery)
    chosen.push_back(away[k]);
  return chosen;
}

/// Objects of the track that the votes do not call dynamic, and that nothing speaks against.
template <class Take>
void take_carried(const Track& track, const std::vector<const Sighting*>& sightings,
                  const Take& take) {
  for (const Member& member : track.members) {
    Rows carried;
    for (const auto k : member.objects) {
      const SeenObject& object = (*sightings[member.sweep])[k];
      if (object.dynamic < object.points) carried.push_back(k);
    }
    if (carried.empty()) continue;
    const auto sweeps = witnesses(track, member);
    if (sweeps.empty()) continue;
    for (const auto k : carried) {
      const SeenObject& object = (*sightings[member.sweep])[k];
      if (std::none_of(sweeps.begin(), sweeps.end(), [&](std::size_t s) {
            return share_taken(object.places, *sightings[s]) >= kTaken;
          }))
        take(member.sweep, object.first);
    }
  }
}

/// Where a track is at any time, from its members in the order of time.
class Way {
 public:
  Way(std::vector<Member> members, const std::vector<double>& times)
      : members_(std::move(members)), times_(times) {
    if (members_.front().sweep > members_.back().sweep)
      std::reverse(members_.begin(), members_.end());
  }
  double start() const { return time(0); }
  double end() const { return time(members_.size() - 1); }

  /// Between two members, or on from the first or last ones.
  Vector at(double t) const {
    const std::size_t count = members_.size();
    if (t <= start()) return between(0, std::min(kLast, count) - 1, 0, t);
    if (t >= end()) return between(count - std::min(kLast, count), count - 1, count - 1, t);
    std::size_t k = 1;
    while (time(k) < t) ++k;
    return between(k - 1, k, k, t);
  }
  float speed(double t) const {
    return (at(t + kSpeedOver) - at(t - kSpeedOver)).norm() / float(2 * kSpeedOver);
  }
  /// The boxes of members within `window`, moved along.
  bool box(double t, double window, Extent& box) const {
    bool any = false;
    const Vector here = at(t);
    for (std::size_t k = 0; k < members_.size(); ++k) {
      if (std::fabs(time(k) - t) > window + 1e-3) continue;
      const Vector shift = here - members_[k].place();
      const Extent moved{members_[k].box.low + shift, members_[k].box.high + shift};
      if (any) box.add(moved);
      if (!any) box = moved;
      any = true;
    }
    return any;
  }

 private:
  double time(std::size_t k) const { return times_[members_[k].sweep]; }
  /// On the line through members a and b, counted from member `from`.
  Vector between(std::size_t a, std::size_t b, std::size_t from, double t) const {
    const auto share = float((t - time(from)) / (time(b) - time(a)));
    return members_[from].place() + share * (members_[b].place() - members_[a].place());
  }

  std::vector<Member> members_;
  const std::vector<double>& times_;
};

/// Where the track is on its way, from a little before its first sighting to after its last.
template <class Take>
void take_boxes(const Track& track, const std::vector<double>& times, const TrackParameters& p,
                const Take& take) {
  if (p.window <= 0) return;
  const Way way(track.members, times);
  Extent box;
  for (std::size_t i = 0; i < times.size(); ++i) {
    const double t = times[i], far = p.gap + 1e-3;
    if (t < way.start() - far || t > way.end() + far || way.speed(t) < kStanding) continue;
    if (way.box(t, p.window, box)) take(i, box);
  }
}

}  // namespace

std::vector<Followed> follow(const std::vector<const Sighting*>& sightings,
                             const std::vector<double>& times, const TrackParameters& p,
                             int threads) {
  std::vector<Followed> ways[2] = {std::vector<Followed>(sightings.size()),
                                   std::vector<Followed>(sightings.size())};
  parallel_for(2, 1, threads, [&](std::size_t backward, std::size_t) {
    auto& found = ways[backward];
    for (const Track& track : Follower(sightings, times, p).run(backward != 0)) {
      if (!moved(track, p)) continue;
      take_carried(track, sightings, [&](std::size_t sweep, std::uint32_t first) {
        found[sweep].objects.push_back(first);
      });
      take_boxes(track, times, p,
                 [&](std::size_t sweep, const Extent& box) { found[sweep].boxes.push_back(box); });
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
