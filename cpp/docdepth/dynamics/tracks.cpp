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
constexpr float kStanding = 0.5f;  ///< slower things may be hidden for long [m/s]
constexpr float kApart = 0.1f;     ///< boxes that far apart: it has left [m]
constexpr float kSame = 0.25f;     ///< a place is taken when another one is that near [m]
constexpr float kTaken = 0.4f;     ///< share of taken places
constexpr std::size_t kEvery = 5, kWitnesses = 4;  ///< sweeps that are asked whether it was free

struct Member {
  std::size_t sweep;
  Rows objects;
  bool moves;  ///< by the votes on that sweep
  Extent box;
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
  const auto middle = [](const Member& m) { return Vector(0.5f * (m.box.low + m.box.high)); };
  const Vector way = middle(track.members.back()) - middle(track.members.front());
  return track.moved >= p.sightings && way.head<2>().norm() >= p.distance;
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

}  // namespace

std::vector<std::vector<std::uint32_t>> follow(const std::vector<const Sighting*>& sightings,
                                               const std::vector<double>& times,
                                               const TrackParameters& p, int threads) {
  std::vector<Rows> ways[2] = {std::vector<Rows>(sightings.size()),
                               std::vector<Rows>(sightings.size())};
  parallel_for(2, 1, threads, [&](std::size_t backward, std::size_t) {
    for (const Track& track : Follower(sightings, times, p).run(backward != 0))
      if (moved(track, p))
        take_carried(track, sightings, [&](std::size_t sweep, std::uint32_t first) {
          ways[backward][sweep].push_back(first);
        });
  });
  std::vector<Rows> result = std::move(ways[0]);
  for (std::size_t i = 0; i < result.size(); ++i) {
    Rows& rows = result[i];
    rows.insert(rows.end(), ways[1][i].begin(), ways[1][i].end());
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
  }
  return result;
}

}  // namespace docdepth
