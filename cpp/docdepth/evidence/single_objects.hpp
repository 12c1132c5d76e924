// Tracks, cut where they went on with another object.
#pragma once

#include <vector>

#include "docdepth/evidence/object_track.hpp"
#include "docdepth/tracking/tracker.hpp"

namespace docdepth {

/// The objects of tracks with enough transient observations (TrackingOptions::min_detections).
///
/// Where its surfaces say that a track went on with another object, it is cut. Surfaces are kept
/// from the first observation of a track to its last.
///
/// @param read   asked for sweeps in order
/// @param times  of the sweeps [s]
std::vector<ObjectTrack> single_objects(std::vector<Track> tracks, const ReadDetections& read,
                                        const std::vector<double>& times,
                                        const TrackingOptions& options, int threads,
                                        const TellProgress& progress);

}  // namespace docdepth
