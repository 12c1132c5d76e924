// Tracks of fragments of one vehicle.
#pragma once

#include <vector>

#include "docdepth/evidence/object_track.hpp"

namespace docdepth {

/// Take out the tracks that are fragments of one vehicle, and merge them: a lorry seen in front of
/// and behind a pole, its wheels, what each petal of a rosette shows of a car. Two solid things
/// cannot lie in each other.
/// @return the merged tracks, without paths; the others stay
std::vector<Track> merge_fragments(std::vector<ObjectTrack>& objects,
                                   const std::vector<double>& times,
                                   const TrackingOptions& options);

}  // namespace docdepth
