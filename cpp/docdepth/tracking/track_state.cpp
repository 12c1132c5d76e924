#include "docdepth/tracking/track_state.hpp"

#include <utility>
#include <vector>

namespace docdepth {

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
