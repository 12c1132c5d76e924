#include "docdepth/tracking/track.hpp"

#include <algorithm>
#include <utility>

namespace docdepth {

TrackObservation observe(std::size_t sweep, const Detections& detections,
                         std::vector<std::uint32_t> objects) {
  TrackObservation seen{.sweep = sweep, .box = detections[objects[0]].box};
  const Detection* largest = &detections[objects[0]];
  std::uint32_t transient = 0, dynamic = 0;
  double offset = 0;
  for (const auto k : objects) {
    const Detection& object = detections[k];
    seen.box.add(object.box);
    seen.points += object.points;
    seen.area += object.area;
    seen.transient_area += object.transient_area();
    seen.free_area += object.free_area;
    if (object.is_transient()) transient += object.points;
    if (object.is_dynamic()) dynamic += object.points;
    offset += double(object.time_offset) * object.points;
    if (object.points > largest->points) largest = &object;
  }
  seen.is_transient = 2 * transient >= seen.points;
  seen.is_dynamic = 2 * dynamic >= seen.points;
  seen.time_offset = offset / double(seen.points);
  seen.ground = largest->ground;
  seen.objects = std::move(objects);
  return seen;
}

}  // namespace docdepth
