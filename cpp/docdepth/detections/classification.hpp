// Evidence shared within objects: an object is dynamic as a whole.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/detections/clustering.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/mesh/scan_mesh.hpp"

namespace docdepth {

/// Isolated points this near to a dynamic object belong to it [m].
constexpr float kObjectMargin = 0.2f;

struct ClassificationOptions {
  // --- Dynamic points are confirmed, or withdrawn ---
  /// Connected dynamic points (ClusteringOptions) confirm each other if there are this many.
  int min_cluster_size = 6;
  ClusteringOptions clustering{};
  /// A confirmed dynamic point within this distance confirms a single one [m].
  float neighbor_radius = 1.0f;
  /// So do this many dynamic votes of its own, more than twice its static ones, if its place was
  /// occupied in one stretch of time.
  int clear_votes = 2;

  // --- Objects are dynamic as a whole ---
  /// An object has at least this many points.
  int min_object_points = 10;
  /// It moves if this share of its points with votes is dynamic,
  float dynamic_share = 0.5f;
  /// and this share of all its points.
  float min_dynamic_share = 0.1f;

  // --- Objects that stand for a while ---
  /// They have at least this horizontal diagonal [m]
  float min_object_width = 1.5f;
  /// and this height [m],
  float min_object_height = 0.3f;
  /// and this share of their points was observed free:
  float observed_free_share = 0.6f;
  /// by at least this many key frames,
  int observed_free_votes = 2;
  /// and by one to less than this many that observed it occupied. With more a point is always
  /// static.
  float max_static_ratio = 8;
  /// Of the points that were observed free, this share was occupied in one stretch of time.
  float occupied_once_share = 1 / 3.0f;

  /// An isolated point inside a dynamic object belongs to it, if its static votes exceed its
  /// dynamic votes by at most this many.
  int isolated_votes = 2;
};

/// Which points of a sweep are dynamic.
///
/// Points that are dynamic by their own votes (more dynamic than static ones) but alone are
/// withdrawn. An object that moves is dynamic as a whole, except for points that were always
/// observed occupied: they belong to something static that is connected to it. An object that
/// stands for a while has many static votes. It is dynamic if enough of its place was observed
/// free, and occupied in one stretch of time. Thin and porous objects are observed free, too, by
/// rays that pass beside and through them, but free and occupied in turn.
///
/// @param ground, static_votes, dynamic_votes, occupied_once  one value per point (Votes)
/// @param objects  row of the first point of each point's object (cluster_objects)
std::vector<std::uint8_t> classify_objects(const Points& points, const bool* ground,
                                           const std::uint32_t* objects,
                                           const std::uint16_t* static_votes,
                                           const std::uint16_t* dynamic_votes,
                                           const bool* occupied_once, const ScanMesh& mesh,
                                           const ClassificationOptions& options = {});

/// Add isolated points inside the box of a dynamic object, unless many more of their votes are
/// static than dynamic. classify_objects() ends with it.
void add_isolated_points(const Points& points, const bool* ground, const std::uint32_t* objects,
                         const std::uint16_t* static_votes, const std::uint16_t* dynamic_votes,
                         std::vector<std::uint8_t>& dynamic,
                         const ClassificationOptions& options = {});

}  // namespace docdepth
