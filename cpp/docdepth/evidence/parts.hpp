// Tracks of parts of one vehicle.
#pragma once

#include <vector>

#include "docdepth/evidence/followed.hpp"

namespace docdepth {

/// Take out the tracks that are parts of one vehicle, and join them: a lorry seen in front of and
/// behind a pole, its wheels, what each petal of a rosette shows of a car. Two solid things that go
/// as fast cannot lie in each other.
/// @return the joined tracks, without paths; the others stay
std::vector<Track> join_parts(Paths& followed, const std::vector<double>& times,
                              const TrackParameters& p);

}  // namespace docdepth
