#include "docdepth/tracking/track.hpp"

#include <algorithm>
#include <utility>

namespace docdepth {

TrackObservation observe(std::size_t sweep, const Detections& detections,
                         std::vector<std::uint32_t> chosen) {
  TrackObservation seen{.sweep = sweep, .box = detections[chosen[0]].box};
  const Detection* largest = &detections[chosen[0]];
  std::uint32_t transient = 0, dynamic = 0;
  double offset = 0;
  for (const auto k : chosen) {
    const Detection& object = detections[k];
    seen.box.add(object.box);
    seen.points += object.points;
    seen.area += object.area;
    seen.transient_area += object.transient_area();
    seen.free_area += object.free_area;
    seen.porous_area += object.porous_area;
    if (object.is_transient()) transient += object.points;
    if (object.is_dynamic()) dynamic += object.points;
    offset += double(object.time_offset) * object.points;
    if (object.points > largest->points) largest = &object;
  }
  seen.is_transient = 2 * transient >= seen.points;
  seen.is_dynamic = 2 * dynamic >= seen.points;
  seen.time_offset = offset / double(seen.points);
  seen.ground = largest->ground;
  seen.detections = std::move(chosen);
  return seen;
}

void append(SampledPoints& samples, const SampledPoints& more) {
  samples.insert(samples.end(), more.begin(), more.end());
}

void append(TimedPoints& samples, const Detection& object) {
  append(samples.points, object.samples());
  const auto& times = object.surface.times;
  samples.times.insert(samples.times.end(), times.begin(), times.end());
}

void TrackState::set_samples(const TimedPoints& older, const TimedPoints& newer,
                             const Eigen::Vector3f& shift, double dt) {
  const Eigen::Vector3f per_second = shift / float(dt);
  const auto at_offset = [&](SampledPoints points) {
    std::vector<float> times(points.size(), offset);
    return TimedPoints{std::move(points), std::move(times)};
  };
  SampledPoints both = at_time(older.points, older.times, per_second, offset);
  for (Eigen::Vector3f& p : both) p += shift;
  last = at_offset(at_time(newer.points, newer.times, per_second, offset));
  append(both, last.points);
  samples =
      at_offset(downsample(both, kSampleSpacing, kMaxSamples, largest_spacing(extent_of(both))));
}

}  // namespace docdepth
