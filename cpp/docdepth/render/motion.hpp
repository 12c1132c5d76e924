// Moving objects of a sweep, and how far each has come in another one.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// What moves of a sweep, by object: those whose returns lie side by side, seen from above.
struct Objects {
  std::vector<std::uint32_t> owner;  ///< of each return: 0 where it does not move, else 1, 2, ...
  /// Places of each object's returns, evenly thinned; of object 1 first.
  std::vector<std::vector<Eigen::Vector3f>> places;
};

/// @param classid ClassId of every point
Objects find_objects(const Points& points, const std::uint16_t* classid);

/// How far each object has come, in the frame of `objects`; zero where it is not found again.
///
/// The shift that brings most places of an object onto those of one of `later` is found by counting
/// all differences between them, then refined. It must explain both: a pedestrian is never lost in
/// a passing car, nor the other way round.
/// @param T_objects_later takes `later` to the frame of `objects`
/// @param reach no object comes farther, metres
std::vector<Eigen::Vector3f> displacements(const Objects& objects, const Objects& later,
                                           const Pose& T_objects_later, float reach, int threads);

}  // namespace docdepth
