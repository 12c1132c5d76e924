#include "docdepth/evidence/parts.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "docdepth/detections/constants.hpp"
#include "docdepth/detections/quantile.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

double time_of(const TrackObservation& seen, const std::vector<double>& times) {
  return times[seen.sweep] + seen.time_offset;
}

/// Where a track is relative to a vehicle at one time, as seen from above.
struct Place {
  bool touches;  ///< their boxes overlap
  bool inside;   ///< its middle lies in the box of the vehicle
  bool beside;   ///< it lies along a side, and both together are no wider than a vehicle
};

Place place_of(const TrackPath& part, const TrackPath& whole, double time) {
  const Eigen::Isometry3f T = (whole.pose(time).inverse() * part.pose(time)).cast<float>();
  const auto middle = [](const Extent& box) { return Vector(0.5f * (box.low + box.high)); };
  const Vector off = (T * middle(part.extent()) - middle(whole.extent())).cwiseAbs();
  const Vector half = 0.5f * whole.extent().size(),
               its = 0.5f * (T.linear().cwiseAbs() * part.extent().size());
  const float width = std::max(half.y(), off.y() + its.y()) + std::max(half.y(), its.y() - off.y());
  const bool along = off.x() < half.x();
  return {off.x() < half.x() + its.x() && off.y() < half.y() + its.y(), along && off.y() < half.y(),
          along && off.y() < half.y() + its.y() + kPartGap && width <= kMaxVehicleWidth};
}

/// Whether a track is a part of a vehicle, while both are known: it touches it and goes as fast, or
/// it stays where the vehicle is while that goes on. Few returns of a piece do not say how fast it
/// is.
bool is_part(const TrackPath& whole, const TrackAndPath& part, const std::vector<double>& times,
             const TrackParameters& p) {
  std::vector<float> speeds;
  std::vector<Eigen::Vector3d> path;  // of the vehicle
  int touching = 0, inside = 0, beside = 0;
  for (const TrackObservation& seen : part.track.observations) {
    const double time = time_of(seen, times);
    if (!whole.covers(time)) continue;
    const Place place = place_of(part.path, whole, time);
    touching += place.touches, inside += place.inside, beside += place.beside;
    speeds.push_back(float((whole.velocity(time) - part.path.velocity(time)).norm()));
    path.push_back(whole.pose(time).translation());
  }
  if (int(speeds.size()) < p.min_detections) return false;
  const auto most = [&](int count) { return float(count) >= kPartShare * float(speeds.size()); };
  const bool is_as_fast = quantile(speeds, 0.5) < kPartSpeed;
  if (most(touching) && is_as_fast) return true;
  if ((path.back() - path.front()).norm() < kPartPath) return false;
  return most(inside) || (most(beside) && is_as_fast);
}

float total_area(const Track& track) {
  float area = 0;
  for (const TrackObservation& seen : track.observations) area += seen.area;
  return area;
}

/// Of each track the largest vehicle that it is a part of, or itself.
std::vector<std::size_t> find_wholes(const Paths& followed, const std::vector<double>& times,
                                     const TrackParameters& p) {
  std::vector<float> areas;
  std::vector<std::size_t> wholes(followed.size());
  for (const auto& one : followed) areas.push_back(total_area(one->track));
  for (std::size_t k = 0; k < followed.size(); ++k) {
    wholes[k] = k;
    const auto& mine = followed[k]->track.observations;
    for (std::size_t other = 0; other < followed.size(); ++other) {
      const auto& [track, path] = *followed[other];
      const bool larger = areas[other] > areas[k] || (areas[other] == areas[k] && other < k);
      if (!larger || areas[other] <= areas[wholes[k]] ||
          !(is_vehicle(path) || is_rear_of_vehicle(path) || is_side_of_vehicle(*followed[other])) ||
          times[track.observations.front().sweep] > times[mine.back().sweep] + p.max_gap_standing ||
          times[mine.front().sweep] > times[track.observations.back().sweep] + p.max_gap_standing)
        continue;
      if (is_part(path, *followed[k], times, p)) wholes[k] = other;
    }
  }
  return wholes;
}

/// What a sweep saw of a vehicle in two parts.
void add(const TrackObservation& part, TrackObservation& seen) {
  const auto most = [&](bool of_part, bool of_seen) {
    return 2 * (of_part * part.points + of_seen * seen.points) >= part.points + seen.points;
  };
  seen.dynamic = most(part.dynamic, seen.dynamic), seen.voted = most(part.voted, seen.voted);
  if (part.points > seen.points) seen.ground = part.ground;
  const double points = double(seen.points) + part.points;
  seen.time_offset = (seen.points * seen.time_offset + part.points * part.time_offset) / points;
  seen.objects.insert(seen.objects.end(), part.objects.begin(), part.objects.end());
  seen.box.add(part.box);
  seen.points += part.points, seen.area += part.area;
  seen.passing_area += part.passing_area, seen.free_area += part.free_area;
}

/// Parts of one vehicle as one track. How far it went from sweep to sweep says the part of which
/// most was seen.
Track joined(const std::vector<const TrackAndPath*>& parts, const std::vector<double>& times) {
  struct Seen {
    const TrackObservation* of;
    const TrackPath* path;
  };
  std::vector<Seen> all;
  for (const TrackAndPath* part : parts)
    for (const TrackObservation& of : part->track.observations) all.push_back({&of, &part->path});
  std::stable_sort(all.begin(), all.end(),
                   [](const Seen& a, const Seen& b) { return a.of->sweep < b.of->sweep; });
  Track track;
  for (auto begin = all.begin(); begin != all.end();) {
    const auto end = std::find_if(
        begin, all.end(), [&](const Seen& other) { return other.of->sweep != begin->of->sweep; });
    TrackObservation seen = *begin->of;
    for (auto part = begin + 1; part != end; ++part) add(*part->of, seen);
    seen.shift = Vector::Zero();
    if (!track.observations.empty()) {
      const TrackPath& path = *std::max_element(begin, end, [](const Seen& a, const Seen& b) {
                                 return a.of->area < b.of->area;
                               })->path;
      const double now = time_of(seen, times);
      const double before = now - times[seen.sweep] + times[track.observations.back().sweep];
      seen.shift = (path.pose(now).translation() - path.pose(before).translation()).cast<float>();
    }
    track.dynamic += seen.dynamic;
    track.observations.push_back(std::move(seen));
    begin = end;
  }
  return track;
}

}  // namespace

std::vector<Track> join_parts(Paths& followed, const std::vector<double>& times,
                              const TrackParameters& p) {
  std::vector<std::size_t> wholes = find_wholes(followed, times, p);
  std::vector<std::vector<const TrackAndPath*>> parts(followed.size());
  for (std::size_t k = 0; k < followed.size(); ++k) {
    std::size_t whole = k;
    while (wholes[whole] != whole) whole = wholes[whole];
    parts[whole].push_back(followed[k].get());
  }
  std::vector<Track> vehicles;
  std::vector<const TrackAndPath*> taken;
  for (const auto& of : parts)
    if (of.size() > 1) {
      vehicles.push_back(joined(of, times));
      taken.insert(taken.end(), of.begin(), of.end());
    }
  const auto is_taken = [&](const auto& one) {
    return std::find(taken.begin(), taken.end(), one.get()) != taken.end();
  };
  followed.erase(std::remove_if(followed.begin(), followed.end(), is_taken), followed.end());
  return vehicles;
}

}  // namespace docdepth
