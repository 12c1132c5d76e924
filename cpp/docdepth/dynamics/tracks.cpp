#include "docdepth/dynamics/tracks.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/dynamics/way.hpp"
#include "docdepth/geometry/parallel.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Flags = std::vector<std::uint8_t>;

constexpr std::size_t kFewestPlaces = 5;  ///< of an object that has a shape to be found by
constexpr float kLowest = 0.15f;          ///< flatter things are ground that was not grown [m]
constexpr float kThinnest = 0.3f;         ///< thinner things stand: poles, from above [m]
constexpr float kWidest = 25.0f;          ///< [m]
constexpr float kMargin = 0.5f;           ///< about where it is looked for [m]
constexpr float kExplained = 0.4f;  ///< share of what is there, less when half of it is not seen
constexpr float kInside = 0.6f;     ///< share of the places of what belongs to it
constexpr std::size_t kPlaces = 100;
constexpr float kThin = 0.15f;
constexpr float kSlow = 2;        ///< key frames near in time saw it stand at its place [m/s]
constexpr float kByVotes = 0.3f;  ///< share of the way that it goes while votes say so

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
  std::vector<std::uint32_t> objects;
  Places places;
  Extent box;
  Vector largest;
};

bool can_be_followed(const Detection& object) {
  return object.box.size().z() >= kLowest && object.box.width() <= kWidest;
}

void append(Places& places, const Places& more) {
  places.insert(places.end(), more.begin(), more.end());
}

/// Follows objects through sightings, one after the other in time or against it.
class Follower {
 public:
  Follower(const std::vector<const Detections*>& sightings, const std::vector<double>& times,
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
    const Detections& seen = *sightings_[sweep];
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
    return (stands && track.moved >= p_.min_detections ? p_.max_gap_standing : p_.max_gap) + 1e-3;
  }

  /// Where it is, if those are its places.
  Match find(const Track& track, const Places& places, const Detections& seen, const Flags& taken,
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
  Match match_from(const Track& track, const Places& places, const Detections& seen,
                   const Flags& taken, const Vector& start, float reach) const {
    Extent box = box_of(places);
    const Vector size = box.size();
    box.low += start;
    box.high += start;
    std::vector<std::uint32_t> near;
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
    const Detections& seen = *sightings_[sweep];
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

  const std::vector<const Detections*>& sightings_;
  const std::vector<double>& times_;
  const TrackParameters& p_;
  std::vector<Track> alive_, done_;
};

bool moved(const Track& track, const TrackParameters& p) {
  const auto& m = track.members;
  const auto way = [&](const Member& to) { return (to.place() - m.front().place()).norm(); };
  return track.moved >= p.min_detections && way(m.back()) >= p.min_distance &&
         way(m[track.last_moved]) >= kByVotes * p.min_distance;
}

/// Whether an object lies in the box, and is no ground at its bottom.
bool inside(const Detection& object, const Extent& box) {
  return (object.box.low.array() >= box.low.array() - kMargin).all() &&
         (object.box.high.array() <= box.high.array() + kMargin).all() &&
         object.box.high.z() >= box.low.z() + kLowest;
}

/// What is known of a track in a sweep.
void find(const Way& way, std::size_t sweep, double time, const Detections& seen,
          const std::vector<const Detections*>& sightings, const TrackParameters& p,
          TrackingResult& found) {
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

std::vector<TrackingResult> track_objects(const std::vector<const Detections*>& sightings,
                                          const std::vector<double>& times,
                                          const TrackParameters& p, int threads) {
  std::vector<TrackingResult> ways[2];
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
  std::vector<TrackingResult> result = std::move(ways[0]);
  for (std::size_t i = 0; i < result.size(); ++i) {
    auto& rows = result[i].objects;
    rows.insert(rows.end(), ways[1][i].objects.begin(), ways[1][i].objects.end());
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
    auto& boxes = result[i].boxes;
    boxes.insert(boxes.end(), ways[1][i].boxes.begin(), ways[1][i].boxes.end());
  }
  return result;
}

}  // namespace docdepth
