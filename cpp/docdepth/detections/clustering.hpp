// The objects of a sweep: connected points above the ground.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"
#include "docdepth/mesh/scan_mesh.hpp"

namespace docdepth {

/// Fewer connected points are no object: their returns are isolated.
constexpr std::uint32_t kMinDetectionPoints = 5;

struct ClusteringOptions {
  /// Neighbouring returns are connected up to this distance [m],
  float distance = 0.3f;
  /// or up to this share of their range, where beams are farther apart [m/m].
  float distance_growth = 0.05f;
  /// Pieces of fewer points than an object are also connected across discontinuities, up to this
  /// share of their range [m/m].
  float piece_distance_growth = 0.03f;
};

/// Object of each point, as the row of its first point. A point of the ground is alone.
///
/// The edges of the mesh connect points. Across discontinuities only pieces of few points are
/// connected: a person whom each ring meets once has no triangle without a corner in the
/// background.
std::vector<std::uint32_t> cluster_objects(const Points& points, const bool* ground,
                                           const ScanMesh& mesh,
                                           const ClusteringOptions& options = {});

}  // namespace docdepth
