// Evidence shared within objects: an object is dynamic as a whole.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/detections/parameters.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/mesh/scan_mesh.hpp"

namespace docdepth {

/// Which points of a sweep are dynamic.
///
/// Points that are dynamic by their own votes (more dynamic than static ones) but alone are
/// withdrawn. An object that moves is dynamic as a whole, except for points that were always
/// observed occupied: they belong to something static that is connected to it. An object that
/// stands for a while has many static votes. It is dynamic if enough of its place was observed
/// free, which hardly ever happens to static objects: only thin ones collect dynamic votes, of rays
/// that pass beside them.
///
/// @param ground, static_votes, dynamic_votes  one value per point
/// @param objects  row of the first point of each point's object (cluster_objects)
std::vector<std::uint8_t> classify_objects(const Points& points, const bool* ground,
                                           const std::uint32_t* objects,
                                           const std::uint16_t* static_votes,
                                           const std::uint16_t* dynamic_votes, const ScanMesh& mesh,
                                           const ObjectParameters& parameters);

/// Add isolated points inside the box of a dynamic object, unless many more of their votes are
/// static than dynamic. classify_objects() ends with it.
void add_isolated_points(const Points& points, const bool* ground, const std::uint32_t* objects,
                         const std::uint16_t* static_votes, const std::uint16_t* dynamic_votes,
                         const ObjectParameters& parameters, std::vector<std::uint8_t>& dynamic);

}  // namespace docdepth
