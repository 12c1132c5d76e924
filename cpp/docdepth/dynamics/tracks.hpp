// Evidence carried over time: what moved once is dynamic also while it stands, and where no key
// frame looked.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/dynamics/sighting.hpp"

namespace docdepth {

struct TrackParameters {
  int min_detections = 3;         ///< in so many sweeps the votes say that it moves,
  float min_distance = 1.0f;      ///< and it went so far, from above [m]
  float max_speed = 40.0f;        ///< [m/s]
  float max_gap = 1.0f;           ///< unseen for longer it is lost [s]
  float max_gap_standing = 5.0f;  ///< where it stands, only after that time [s]
  float window = 0.3f;            ///< sightings so near in time tell how far it reaches [s]
};

/// What following finds in a sweep.
struct TrackingResult {
  std::vector<std::uint32_t> objects;  ///< `first` of those that move, but not by votes on it
  std::vector<Extent> boxes;           ///< where something is on its way, seen or not
};

/// Objects that move at some time of the drive, and where they are, sweep by sweep.
///
/// An object that the votes call dynamic is followed from sweep to sweep, forward and once more
/// backward: objects that fall onto its shifted places are the same one, unless together they are
/// larger than it looks whole. Each sweep of a rosette, or of few beams, sees other parts of it, so
/// its places are those of the last two sightings. So it is followed into where it stands before or
/// after, and to where nobody voted. What is carried along in this way must have been free while
/// the object was elsewhere, else another thing stands there: a parked car that was passed closely,
/// a pole, a wall. And as many points must have been seen to move at once, or many more in all
/// sweeps: of a walker whom few returns met nobody can tell that it is he who stands there, no bin.
///
/// Between its sightings, and a little before and after, an object is where its way leads; its box
/// there is that of all sightings which are near in time, moved along.
///
/// @param times seconds
std::vector<TrackingResult> track_objects(const std::vector<const Detections*>& sightings,
                                          const std::vector<double>& times,
                                          const TrackParameters& parameters, int threads);

}  // namespace docdepth
