// Tracking: an object that moves at one time is dynamic also while it stands, and where no key
// frame looked. Beyond the paper.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/objects/detections.hpp"

namespace docdepth {

struct TrackParameters {
  /// A track is dynamic if the votes call it dynamic in this many sweeps,
  int min_detections = 3;
  /// and if it went this far [m].
  float min_distance = 1.0f;
  /// Fastest road user [m/s].
  float max_speed = 40.0f;
  /// A moving object that is hidden for longer is lost [s].
  float max_gap = 1.0f;
  /// The same for a standing object [s].
  float max_gap_standing = 5.0f;
  /// The extent of an object, and the dynamic voxels of a sweep, come from the sweeps within this
  /// time [s]. 0: only detections that belong to a track become dynamic.
  double window = 0.3;
};

/// The tracks in one sweep.
struct TrackingResult {
  std::vector<std::uint32_t>
      objects;                        ///< first rows of objects that tracking calls dynamic, sorted
  std::vector<Extent> boxes;          ///< of moving objects, in the world, detected or not
  std::vector<std::uint64_t> voxels;  ///< dynamic voxels, ascending (dynamic_voxels)
};

/// Find the objects that move at some time of the drive, and where they are in each sweep.
///
/// An object that the votes call dynamic is tracked from sweep to sweep, forward and once more
/// backward. Objects that fall onto its shifted samples belong to it, unless together they are
/// larger than it ever looks. Its samples are those of the last two sweeps, since a sensor of few
/// beams or a rosette sees other parts in each sweep. So it is tracked to where it stands before or
/// after, and to where no key frame looked.
///
/// A static detection becomes dynamic only if its place was free while the object was elsewhere,
/// else it is another thing: a parked car that was passed, a pole, a wall. And as many points must
/// have been dynamic before: a pedestrian of few points cannot be told from a static object.
///
/// Between its observations, and a little before and after, an object is where its motion leads.
///
/// @param times  of the sweeps [s]
std::vector<TrackingResult> track_objects(const std::vector<const Detections*>& detections,
                                          const std::vector<double>& times,
                                          const TrackParameters& parameters, int threads);

}  // namespace docdepth
