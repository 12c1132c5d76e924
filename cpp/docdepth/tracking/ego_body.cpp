#include "docdepth/tracking/ego_body.hpp"

#include <algorithm>

#include "docdepth/tracking/constants.hpp"

namespace docdepth {
namespace {

/// The vehicle that carries the LiDAR is what it sees within this distance [m]
constexpr float kEgoReach = 3;
/// at one place of its own frame in this share of the sweeps,
constexpr float kEgoShare = 0.8f;
/// while it goes so far [m]. Nothing else keeps beside it for a whole drive.
constexpr float kMinEgoPath = 5;

bool is_beside(const Detection& object) {
  return object.middle.norm() <= kEgoReach;
}

}  // namespace

void EgoBody::add(const Detections& seen) {
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

bool EgoBody::contains(const Detection& object) const {
  return is_beside(object) && std::any_of(places_.begin(), places_.end(), [&](const Place& place) {
           return (place.middle - object.middle).norm() <= kSamePlace &&
                  float(place.sweeps) >= kEgoShare * float(sweeps_) &&
                  place.where.width() >= kMinEgoPath;
         });
}

}  // namespace docdepth
