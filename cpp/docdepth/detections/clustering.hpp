// The objects of a sweep: connected points above the ground.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/detections/parameters.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/mesh/scan_mesh.hpp"

namespace docdepth {

/// Object of each point, as the row of its first point. A point of the ground is alone.
///
/// The edges of the mesh connect points. Across discontinuities only pieces of few points are
/// connected: a person whom each ring meets once has no triangle without a corner in the
/// background.
std::vector<std::uint32_t> cluster_objects(const Points& points, const bool* ground,
                                           const ScanMesh& mesh,
                                           const ObjectParameters& parameters);

}  // namespace docdepth
