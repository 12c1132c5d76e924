#include "docdepth/tracking/ego_places.hpp"

#include <algorithm>

#include "docdepth/detections/constants.hpp"

namespace docdepth {
namespace {

bool is_beside(const Detection& object) {
  return object.middle.norm() <= kEgoReach;
}

}  // namespace

void EgoPlaces::add(const Detections& seen) {
  ++sweeps_;
  for (const Detection& object : seen) {
    if (!is_beside(object)) continue;
    const auto is_it = [&](const Place& place) {
      return (place.middle - object.middle).norm() <= kSamePlace;
    };
    auto place = std::find_if(places_.begin(), places_.end(), is_it);
    if (place == places_.end())
      place = places_.insert(place, {object.middle, object.box});
    else
      place->where.add(object.box);
    place->sweeps += place->last != sweeps_;
    place->last = sweeps_;
  }
}

bool EgoPlaces::hold(const Detection& object) const {
  return is_beside(object) && std::any_of(places_.begin(), places_.end(), [&](const Place& place) {
           return (place.middle - object.middle).norm() <= kSamePlace &&
                  float(place.sweeps) >= kEgoShare * float(sweeps_) &&
                  place.where.width() >= kMinEgoPath;
         });
}

}  // namespace docdepth
