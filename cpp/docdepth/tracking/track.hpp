// An object followed from sweep to sweep.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/detections/detections.hpp"

namespace docdepth {

/// What one sweep saw of a track.
struct TrackObservation {
  std::size_t sweep;
  std::vector<std::uint32_t> objects;  ///< indices of its detections
  Extent box;                          ///< around them
  /// How far it went between the stamps of the last observation and of this one: the samples
  /// registered [m].
  Eigen::Vector3f shift;
  float shift_error;  ///< how wrong that may be [m]
  bool dynamic;       ///< whether most of it is passing by its votes
  bool voted;         ///< whether the votes call most of it dynamic
  /// Of its points, of those that are passing, and of those whose place was free (Detection).
  float area, passing_area, free_area;
  std::uint32_t points;  ///< of its objects
  double time_offset;    ///< mean time of these points [s after the sweep's stamp]
  Height ground;         ///< under the object of most points

  bool is_passing() const { return passing_area >= kMinFreeShare * area; }
};

struct Track {
  std::vector<TrackObservation> observations;  ///< ascending in time
  int dynamic = 0;                             ///< how many of them are dynamic
};

}  // namespace docdepth
