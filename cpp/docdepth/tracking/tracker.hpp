// Follows objects from sweep to sweep.
#pragma once

#include <vector>

#include "docdepth/tracking/detection_window.hpp"
#include "docdepth/tracking/options.hpp"
#include "docdepth/tracking/track.hpp"

namespace docdepth {

/// Follow the objects that the votes call dynamic, forward in time and then backward.
///
/// An object of the next sweep belongs to a track if it falls onto the track's shifted samples,
/// unless together they are larger than the object ever looked. These samples are those of the last
/// two sweeps, since a sensor of few beams or a rosette sees other parts in each sweep. So an
/// object is followed to where it stands before or after, and to where no key frame looked. After a
/// gap it does not go on with what stood there already. Two tracks become one where the later,
/// followed backward, meets the end of the earlier. What the LiDAR sees of its own vehicle is not
/// tracked (EgoBody).
///
/// @param times  of the sweeps [s]
std::vector<Track> follow_objects(const ReadDetections& read, const std::vector<double>& times,
                                  const TrackingOptions& options);

}  // namespace docdepth
