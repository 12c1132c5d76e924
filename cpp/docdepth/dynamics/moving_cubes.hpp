// Where the sweeps just before and after saw little but what moves.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/dynamics/tracks.hpp"

namespace docdepth {

/// The cube that holds a place, as a number.
std::uint64_t cube_of(const Eigen::Vector3f& place);

/// For each sweep the cubes, in order, in which the sweeps near in time saw objects that move, and
/// few that stand. What the sweep sees there, a few beams on somebody, is most likely of the same:
/// it may be too little for an object, or its object too little seen by key frames.
///
/// @param times  seconds
/// @param followed  what following found, which moves as well as what moves by its votes
std::vector<std::vector<std::uint64_t>> moving_cubes(
    const std::vector<const Detections*>& sightings, const std::vector<double>& times,
    const std::vector<TrackingResult>& followed, int threads);

}  // namespace docdepth
