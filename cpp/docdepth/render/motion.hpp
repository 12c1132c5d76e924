// Moving objects of a sweep, and how fast each is, told by another sweep.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"
#include "docdepth/render/camera.hpp"

namespace docdepth {

/// What moves of a sweep, by object: those whose returns lie side by side, seen from above.
struct Objects {
  std::vector<std::uint32_t> owner;  ///< of each return: 0 where it does not move, else 1, 2, ...
  /// Places of each object's returns, evenly thinned; of object 1 first.
  std::vector<std::vector<Eigen::Vector3f>> places;
  std::vector<float> late;  ///< when each was measured, seconds after the sweep's stamp

  std::vector<Box> boxes() const;  ///< around each object's places
};

/// @param classid ClassId of every point
/// @param late when every point was measured, seconds after the sweep's stamp; may be null
Objects find_objects(const Points& points, const std::uint16_t* classid, const float* late);

/// What is known of the way from one sweep to another.
struct Passage {
  Pose T_from_to;
  float duration;  ///< seconds from stamp to stamp; negative where the other sweep came before
  float max_speed;
};

/// Velocity of each object in the frame of `objects`, m/s; zero where it is not found again.
///
/// The shift that brings most places of an object onto those of one of `other` is found by counting
/// all differences between them, then refined. It must explain both: a pedestrian is never lost in
/// a passing car, nor the other way round.
/// @param wanted 1 for each object that is looked for; empty for all
std::vector<Eigen::Vector3f> velocities(const Objects& objects, const Objects& other,
                                        const Passage& passage, int threads,
                                        const std::vector<std::uint8_t>& wanted = {});

/// An object as another sweep saw it.
struct Again {
  Eigen::Vector3f shift;               ///< from where the object is to where it was seen there
  std::vector<std::uint32_t> objects;  ///< what is of it there, counted from 0
};

/// Finds each object, where it must have been by its velocity, among those of another sweep; none
/// of these is of two. What does not move is not looked for.
std::vector<Again> find_again(const Objects& objects,
                              const std::vector<Eigen::Vector3f>& velocities, const Objects& other,
                              const Passage& passage);

}  // namespace docdepth
