#include "docdepth/detections/clustering.hpp"

#include "docdepth/detections/connectivity.hpp"

namespace docdepth {

std::vector<std::uint32_t> cluster_objects(const Points& points, const bool* ground,
                                           const ScanMesh& mesh, const ClusteringOptions& options) {
  DisjointSets sets(points.rows());
  const auto above_ground = [&](std::uint32_t i) { return !ground[i]; };
  join_corners(points, mesh, false, options.distance, options.distance_growth, above_ground, sets);
  auto first = sets.first();
  std::vector<std::uint32_t> size(first.size());
  for (const auto f : first) ++size[f];
  std::vector<std::uint8_t> piece(first.size());
  for (std::uint32_t i = 0; i < piece.size(); ++i)
    piece[i] = !ground[i] && size[first[i]] < kMinDetectionPoints;
  const auto in_piece = [&](std::uint32_t i) { return piece[i] != 0; };
  join_corners(points, mesh, true, options.distance, options.piece_distance_growth, in_piece, sets);
  for (std::uint32_t i = 0; i < piece.size(); ++i)
    if (piece[i]) first[i] = sets.find(i);
  return first;
}

}  // namespace docdepth
