#include "docdepth/evidence/fragments.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

#include "docdepth/geometry/box_tree.hpp"
#include "docdepth/tracking/constants.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// A track is a fragment of a vehicle if it touches it in this share of the sweeps that saw both.
constexpr float kFragmentShare = 0.8f;
/// Nothing else stays in the outline of a vehicle, or so near to its side [m],
constexpr float kFragmentGap = 0.25f;
/// while it goes so far [m].
constexpr float kFragmentPath = 3;
/// Fragments are looked for so far beside a vehicle [m]: the gap, and rounding.
constexpr float kReachMargin = 2 * kFragmentGap;

double time_of(const TrackObservation& seen, const std::vector<double>& times) {
  return times[seen.sweep] + seen.time_offset;
}

/// Where a track is relative to a vehicle at one time, as seen from above.
struct RelativePlace {
  bool touches;  ///< their boxes overlap
  bool inside;   ///< its middle lies in the box of the vehicle
  bool beside;   ///< it lies along a side, and both together are no wider than a vehicle
};

RelativePlace place_of(const TrackPath& fragment, const TrackPath& vehicle, double time) {
  const Eigen::Isometry3f T = (vehicle.pose(time).inverse() * fragment.pose(time)).cast<float>();
  const auto middle = [](const Extent& box) { return Vector(0.5f * (box.low + box.high)); };
  const Vector off = (T * middle(fragment.extent()) - middle(vehicle.extent())).cwiseAbs();
  const Vector half = 0.5f * vehicle.extent().size(),
               its = 0.5f * (T.linear().cwiseAbs() * fragment.extent().size());
  const float width = std::max(half.y(), off.y() + its.y()) + std::max(half.y(), its.y() - off.y());
  const bool along = off.x() < half.x();
  return {
      .touches = off.x() < half.x() + its.x() && off.y() < half.y() + its.y(),
      .inside = along && off.y() < half.y(),
      .beside = along && off.y() < half.y() + its.y() + kFragmentGap && width <= kMaxVehicleWidth};
}

/// Whether a track is a fragment of a vehicle, while both are known: it touches it, or it stays
/// where the vehicle is while that goes on. Few returns of a piece do not say how fast it is.
bool is_fragment(const TrackPath& vehicle, const ObjectTrack& fragment,
                 const std::vector<double>& times, int min_detections) {
  std::vector<Eigen::Vector3d> path;  // of the vehicle
  int touching = 0, inside = 0, beside = 0;
  for (const TrackObservation& seen : fragment.track.observations) {
    const double time = time_of(seen, times);
    if (!vehicle.covers(time)) continue;
    const RelativePlace place = place_of(fragment.path, vehicle, time);
    touching += place.touches;
    inside += place.inside;
    beside += place.beside;
    path.push_back(vehicle.pose(time).translation());
  }
  if (int(path.size()) < min_detections) return false;
  const auto most = [&](int count) { return float(count) >= kFragmentShare * float(path.size()); };
  if (most(touching)) return true;
  return (path.back() - path.front()).norm() >= kFragmentPath && (most(inside) || most(beside));
}

float total_area(const Track& track) {
  float area = 0;
  for (const TrackObservation& seen : track.observations) area += seen.area;
  return area;
}

/// Of each track the largest vehicle that it is a fragment of, or itself.
std::vector<std::size_t> find_vehicles(const std::vector<ObjectTrack>& objects,
                                       const std::vector<double>& times,
                                       const TrackingOptions& options) {
  std::vector<float> areas;
  std::vector<Extent> reaches;
  std::vector<std::size_t> vehicles(objects.size());
  for (const ObjectTrack& object : objects) {
    areas.push_back(total_area(object.track));
    reaches.push_back(object.path.reach());
  }
  const BoxTree places(reaches);
  for (std::size_t k = 0; k < objects.size(); ++k) {
    vehicles[k] = k;
    const auto& mine = objects[k].track.observations;
    for (const std::size_t other : places.near(reaches[k], kReachMargin)) {
      const auto& [track, path] = objects[other];
      const bool larger = areas[other] > areas[k] || (areas[other] == areas[k] && other < k);
      if (!larger || areas[other] <= areas[vehicles[k]] ||
          !(is_vehicle(path) || is_rear_of_vehicle(path)) ||
          times[track.observations.front().sweep] >
              times[mine.back().sweep] + options.max_gap_standing ||
          times[mine.front().sweep] >
              times[track.observations.back().sweep] + options.max_gap_standing)
        continue;
      if (is_fragment(path, objects[k], times, options.min_detections)) vehicles[k] = other;
    }
  }
  return vehicles;
}

/// What a sweep saw of a vehicle in two fragments.
void add(const TrackObservation& fragment, TrackObservation& seen) {
  const auto most = [&](bool of_fragment, bool of_seen) {
    return 2 * (of_fragment * fragment.points + of_seen * seen.points) >=
           fragment.points + seen.points;
  };
  seen.is_transient = most(fragment.is_transient, seen.is_transient);
  seen.is_dynamic = most(fragment.is_dynamic, seen.is_dynamic);
  if (fragment.points > seen.points) seen.ground = fragment.ground;
  const double points = double(seen.points) + fragment.points;
  seen.time_offset =
      (seen.points * seen.time_offset + fragment.points * fragment.time_offset) / points;
  seen.detections.insert(seen.detections.end(), fragment.detections.begin(),
                         fragment.detections.end());
  seen.box.add(fragment.box);
  seen.points += fragment.points;
  seen.area += fragment.area;
  seen.transient_area += fragment.transient_area;
  seen.free_area += fragment.free_area;
  seen.porous_area += fragment.porous_area;
}

/// Fragments of one vehicle as one track. How far it went from sweep to sweep says the fragment of
/// which most was seen.
Track merged(const std::vector<const ObjectTrack*>& fragments, const std::vector<double>& times) {
  struct Seen {
    const TrackObservation* of;
    const TrackPath* path;
  };
  std::vector<Seen> all;
  for (const ObjectTrack* fragment : fragments)
    for (const TrackObservation& of : fragment->track.observations)
      all.push_back({&of, &fragment->path});
  std::stable_sort(all.begin(), all.end(),
                   [](const Seen& a, const Seen& b) { return a.of->sweep < b.of->sweep; });
  Track track;
  for (auto begin = all.begin(); begin != all.end();) {
    const auto end = std::find_if(
        begin, all.end(), [&](const Seen& other) { return other.of->sweep != begin->of->sweep; });
    TrackObservation seen = *begin->of;
    for (auto fragment = begin + 1; fragment != end; ++fragment) add(*fragment->of, seen);
    seen.shift = Vector::Zero();
    if (!track.observations.empty()) {
      const TrackPath& path = *std::max_element(begin, end, [](const Seen& a, const Seen& b) {
                                 return a.of->area < b.of->area;
                               })->path;
      const double now = time_of(seen, times);
      const double before = now - times[seen.sweep] + times[track.observations.back().sweep];
      seen.shift = (path.pose(now).translation() - path.pose(before).translation()).cast<float>();
    }
    track.transient_count += seen.is_transient;
    track.observations.push_back(std::move(seen));
    begin = end;
  }
  return track;
}

}  // namespace

std::vector<Track> merge_fragments(std::vector<ObjectTrack>& objects,
                                   const std::vector<double>& times,
                                   const TrackingOptions& options) {
  const std::vector<std::size_t> vehicles = find_vehicles(objects, times, options);
  std::vector<std::vector<const ObjectTrack*>> fragments(objects.size());
  for (std::size_t k = 0; k < objects.size(); ++k) {
    std::size_t vehicle = k;
    while (vehicles[vehicle] != vehicle) vehicle = vehicles[vehicle];
    fragments[vehicle].push_back(&objects[k]);
  }
  std::vector<Track> found;
  std::vector<bool> taken(objects.size());
  for (const auto& of : fragments) {
    if (of.size() < 2) continue;
    found.push_back(merged(of, times));
    for (const ObjectTrack* fragment : of) taken[std::size_t(fragment - objects.data())] = true;
  }
  std::vector<ObjectTrack> others;
  for (std::size_t k = 0; k < objects.size(); ++k)
    if (!taken[k]) others.push_back(std::move(objects[k]));
  objects = std::move(others);
  return found;
}

}  // namespace docdepth
