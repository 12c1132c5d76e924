// Dynamic objects of a sweep, and how fast each is, from another sweep.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/render/camera.hpp"

namespace docdepth {

/// The dynamic returns of a sweep, clustered in the ground plane.
struct DynamicObjects {
  std::vector<std::uint32_t> owner;    ///< object of each return: 1, 2, ...; 0 if it is not dynamic
  std::vector<SampledPoints> samples;  ///< of object 1, 2, ...
  std::vector<float> time_offset;      ///< mean time of each object [s after the sweep's stamp]

  std::vector<Box> boxes() const;  ///< around the samples of each object
};

/// @param classid      ClassId of every point
/// @param time_offset  time of every point [s after the sweep's stamp]; may be null
DynamicObjects find_dynamic_objects(const Points& points, const std::uint16_t* classid,
                                    const float* time_offset);

/// From one sweep to another.
struct RelativeMotion {
  Pose T_from_to;
  float duration;   ///< between the stamps [s]; negative if the other sweep came before
  float max_speed;  ///< of objects [m/s]
};

/// Velocity of each object in the frame of `objects` [m/s]; zero if it is not found in `other`.
///
/// The shift that brings most samples of an object onto those of another is found in a histogram of
/// all differences, then refined. It has to explain both objects, so that a pedestrian is never
/// matched with a passing car.
/// @param wanted  1 for each object to match; empty for all
std::vector<Eigen::Vector3f> match_velocities(const DynamicObjects& objects,
                                              const DynamicObjects& other,
                                              const RelativeMotion& motion, int threads,
                                              const std::vector<std::uint8_t>& wanted = {});

/// An object as another sweep saw it.
struct Reassociation {
  Eigen::Vector3f shift;               ///< from the object to where the other sweep saw it [m]
  std::vector<std::uint32_t> objects;  ///< its parts in the other sweep, counted from 0
};

/// Find each moving object in another sweep, at the place where its velocity takes it. No object of
/// the other sweep is used twice.
std::vector<Reassociation> reassociate(const DynamicObjects& objects,
                                       const std::vector<Eigen::Vector3f>& velocities,
                                       const DynamicObjects& other, const RelativeMotion& motion);

}  // namespace docdepth
