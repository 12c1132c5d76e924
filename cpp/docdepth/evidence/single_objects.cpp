#include "docdepth/evidence/single_objects.hpp"

#include <algorithm>
#include <span>
#include <utility>
#include <variant>

#include "docdepth/geometry/parallel.hpp"

namespace docdepth {
namespace {

/// So many tracks are made into paths at once.
constexpr std::size_t kTracksAtOnce = 32;

/// A track from one observation up to another.
Track slice(const Track& track, std::size_t begin, std::size_t end) {
  Track part;
  part.observations.assign(track.observations.begin() + std::ptrdiff_t(begin),
                           track.observations.begin() + std::ptrdiff_t(end));
  for (const TrackObservation& seen : part.observations) part.transient_count += seen.is_transient;
  return part;
}

/// A track and what its observations saw, as far as they have been read.
struct SeenTrack {
  std::size_t number;  ///< among all
  Track track;
  std::vector<ObservedSurface> surfaces;
};

/// What an observation saw, and when.
ObservedSurface surface_of(const TrackObservation& seen, const Detections& detections) {
  ObservedSurface surface;
  const auto append = [&](SampledPoints& points, std::vector<float>& times,
                          const SampledPoints& more, const std::vector<float>& more_times) {
    points.insert(points.end(), more.begin(), more.end());
    for (const float time : more_times) times.push_back(time - float(seen.time_offset));
  };
  for (const auto of : seen.detections) {
    const Detection& part = detections[of];
    const TimedSurface& its = part.surface;
    append(surface.points, surface.times, its.points, its.times);
    surface.normals.insert(surface.normals.end(), its.normals.begin(), its.normals.end());
    append(surface.edges.points, surface.edges.times, part.edges.points, part.edges.times);
    append(surface.hidden.points, surface.hidden.times, part.hidden.points, part.hidden.times);
  }
  return surface;
}

/// The track, cut where its surfaces say that it went on with another object, in order of time.
std::vector<ObjectTrack> cut(SeenTrack whole, const std::vector<double>& times,
                             const TrackingOptions& options) {
  std::vector<ObjectTrack> single;
  std::vector<std::pair<Track, std::size_t>> open;  // and its first observation in the whole
  open.emplace_back(std::move(whole.track), 0);
  while (!open.empty()) {
    auto [track, first] = std::move(open.back());
    open.pop_back();
    if (track.transient_count < options.min_detections) continue;
    const std::size_t count = track.observations.size();
    auto estimate = estimate_path(track, std::span(whole.surfaces).subspan(first, count), times);
    if (auto* path = std::get_if<Path>(&estimate)) {
      single.push_back({std::move(track), TrackPath(std::move(*path), options)});
      continue;
    }
    // In order of time: the earliest part is taken out first.
    const auto [begin, end] = std::get<Cut>(estimate);
    if (end < count) open.emplace_back(slice(track, end, count), first + end);
    open.emplace_back(slice(track, begin, end), first + begin);
    if (begin > 0) open.emplace_back(slice(track, 0, begin), first);
  }
  return single;
}

}  // namespace

std::vector<ObjectTrack> single_objects(std::vector<Track> tracks, const ReadDetections& read,
                                        const std::vector<double>& times,
                                        const TrackingOptions& options, int threads,
                                        const TellProgress& progress) {
  std::vector<std::vector<std::size_t>> begin(times.size());  // tracks by their first sweep
  for (std::size_t k = 0; k < tracks.size(); ++k)
    if (tracks[k].transient_count >= options.min_detections)
      begin[tracks[k].observations.front().sweep].push_back(k);
    else
      tracks[k] = {};
  std::vector<std::vector<ObjectTrack>> parts(tracks.size());
  std::vector<SeenTrack> open, whole;
  const auto estimate_paths = [&] {
    parallel_for(whole.size(), 1, threads, [&](std::size_t k, std::size_t) {
      parts[whole[k].number] = cut(std::move(whole[k]), times, options);
    });
    whole.clear();
  };
  for (std::size_t i = 0; i < times.size(); ++i) {
    progress(double(i) / double(times.size()));
    for (const std::size_t k : begin[i]) open.push_back({k, std::move(tracks[k]), {}});
    const auto is_seen = [&](const SeenTrack& seen) {
      return seen.track.observations[seen.surfaces.size()].sweep == i;
    };
    if (std::none_of(open.begin(), open.end(), is_seen)) continue;
    const auto detections = read(i);
    for (SeenTrack& seen : open) {
      const auto& observations = seen.track.observations;
      if (!is_seen(seen)) continue;
      seen.surfaces.push_back(surface_of(observations[seen.surfaces.size()], *detections));
      if (seen.surfaces.size() == observations.size()) whole.push_back(std::move(seen));
    }
    const auto is_whole = [](const SeenTrack& seen) { return seen.track.observations.empty(); };
    open.erase(std::remove_if(open.begin(), open.end(), is_whole), open.end());
    if (whole.size() >= kTracksAtOnce) estimate_paths();
  }
  estimate_paths();
  progress(1);
  std::vector<ObjectTrack> single;
  for (auto& of : parts)
    for (ObjectTrack& part : of) single.push_back(std::move(part));
  return single;
}

}  // namespace docdepth
