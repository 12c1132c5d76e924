// Tracks with their paths, and what kinds of things these are.
#pragma once

#include <vector>

#include "docdepth/paths/track_path.hpp"
#include "docdepth/tracking/track.hpp"

namespace docdepth {

/// The track of one object, and where the object is.
struct ObjectTrack {
  Track track;
  TrackPath path;
};

/// Whether it is large and solid enough for what comes and goes without being seen to move. Pieces
/// of walls that show behind something are flat.
bool is_vehicle(const TrackPath& path);

/// Whether it is a vehicle that goes several times its length, once its length while it is
/// transient. A fence has no width, and what seems to move of a hedge stays where the hedge is.
bool drives_far(const TrackPath& path);

/// Whether it is the rear or the front of a vehicle, which is all that is seen of it: as wide as no
/// person is, and flat along its way.
bool is_rear_of_vehicle(const TrackPath& path);

/// Whether it is long, thin, and lower than any side of a car: no road user at all. What is seen of
/// a rail goes along with us, or with a car that hides the rest.
bool is_rail(const TrackPath& path);

/// Whether the object moves at some time: by its path, or as it was not there before or after.
bool moves(const ObjectTrack& object, const std::vector<double>& times,
           const TrackingOptions& options);

}  // namespace docdepth
