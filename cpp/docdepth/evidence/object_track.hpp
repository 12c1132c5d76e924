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

/// Whether it is as wide as a vehicle and goes several times its length, once its length while it
/// is transient. A fence has no width, and what seems to move of a hedge stays where the hedge is.
bool drives_far(const TrackPath& path);

/// Whether it is the side of a lorry or a bus, which is all that is seen of it: long, thin, higher
/// than any crash barrier, and in most sweeps its place was free before or after.
bool is_side_of_vehicle(const ObjectTrack& object);

/// Whether it is the rear or the front of a vehicle, which is all that is seen of it: as wide as no
/// person is, and flat along its way.
bool is_rear_of_vehicle(const TrackPath& path);

/// Whether it is another long, thin thing that seems to go along itself. What is seen of a guard
/// rail goes along with us, or with a car that hides the rest; or it is the side of a car.
bool is_rail(const ObjectTrack& object);

/// Whether it is a rail that is lower than any side of a car: no road user at all.
bool is_low_rail(const ObjectTrack& object);

/// Whether the object moves at some time: by its path, or as it was not there before or after.
bool moves(const ObjectTrack& object, const std::vector<double>& times,
           const TrackingOptions& options);

}  // namespace docdepth
