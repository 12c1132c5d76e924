// What one sweep saw above the ground, object by object, small enough to be kept for a whole drive.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/geometry/places.hpp"
#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Connected returns off the ground.
struct Detection {
  std::uint32_t first = 0;    ///< row of its first point
  std::uint32_t points = 0;   ///< how many there are
  std::uint32_t dynamic = 0;  ///< how many of them are dynamic by the votes
  Extent box;
  Places places;  ///< evenly thinned

  bool moves() const { return 2 * dynamic >= points; }
};

using Detections = std::vector<Detection>;

/// The objects of a sweep that have more than a few points, in the order of their first ones.
///
/// @param first  of each point the row of its object's first point (`cluster_objects`)
/// @param moving  what the votes on this sweep say
/// @param T_world_lidar  its origin not farther than float can tell centimetres
Detections sight(const Points& points, const bool* ground, const std::uint32_t* first,
                 const bool* moving, const Pose& T_world_lidar);

}  // namespace docdepth
