// An object followed from sweep to sweep.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/detections/detections.hpp"

namespace docdepth {

/// What one sweep saw of a track.
struct TrackObservation {
  std::size_t sweep = 0;
  std::vector<std::uint32_t> objects{};  ///< indices of its detections
  Extent box{};                          ///< around them
  /// How far it went between the stamps of the last observation and of this one, by its samples
  /// [m].
  Eigen::Vector3f shift = Eigen::Vector3f::Zero();
  float shift_error = 0;      ///< how wrong that may be [m]
  bool is_transient = false;  ///< whether most of its points are of transient detections
  bool is_dynamic = false;    ///< whether most of its points are of dynamic detections
  float area = 0;             ///< of its points (Detection)
  float transient_area = 0;   ///< of those that are transient
  float free_area = 0;        ///< of those whose place was free
  std::uint32_t points = 0;   ///< of its objects
  double time_offset = 0;     ///< mean time of these points [s after the sweep's stamp]
  GroundHeight ground{};      ///< under the object of most points

  bool is_mostly_transient() const { return transient_area >= kMinFreeShare * area; }
};

/// Some detections of a sweep as an observation, without a shift.
TrackObservation observe(std::size_t sweep, const Detections& detections,
                         std::vector<std::uint32_t> objects);

struct Track {
  std::vector<TrackObservation> observations;  ///< ascending in time
  int transient_count = 0;                     ///< how many of them are transient
};

}  // namespace docdepth
