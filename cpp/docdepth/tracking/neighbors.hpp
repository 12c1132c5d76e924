// What touches an object but is none of it: a parked car beside one that arrives.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <vector>

#include "docdepth/detections/detections.hpp"

namespace docdepth {

/// Whether things together are wider than any vehicle, whichever way it is turned.
bool are_too_wide(std::initializer_list<const SampledPoints*> things);

/// Whether clearly less of the place of a detection was free before or after than this share of it.
bool was_less_free(const Detection& object, float share);

/// Detections that continue a track, without those that do not belong together.
///
/// What belongs together comes together. So a detection is a neighbor if its place was less free
/// before or after than that of the others, and was occupied before them or after. And it is one if
/// both together are wider than any vehicle.
///
/// @param seen    detections of a sweep
/// @param chosen  indices of some of them; neighbors are removed
/// @return samples of the neighbors
SampledPoints drop_neighbors(const Detections& seen, std::vector<std::uint32_t>& chosen);

/// Whether a detection lies where neighbors of a track were seen: what was told apart stays apart.
bool is_among(const Detection& object, const SampledPoints& neighbors);

}  // namespace docdepth
