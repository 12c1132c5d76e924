// Parameters of clustering and of the classification of objects. Beyond the paper.
#pragma once

namespace docdepth {

struct ObjectParameters {
  // --- Clustering ---
  /// Neighbouring returns are connected up to this distance [m],
  float cluster_distance = 0.3f;
  /// or up to this share of their range, where beams are farther apart [m/m].
  float cluster_distance_growth = 0.05f;

  // --- Dynamic points are confirmed, or withdrawn ---
  /// Connected dynamic points confirm each other if there are this many.
  int min_cluster_size = 6;
  /// A confirmed dynamic point within this distance confirms a single one [m].
  float neighbor_radius = 1.0f;
  /// So do this many dynamic votes of its own,
  int clear_votes = 2;
  /// if they outnumber its static votes this many times.
  float clear_ratio = 4;

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

  /// An isolated point inside a dynamic object belongs to it, if its static votes exceed its
  /// dynamic votes by at most this many.
  int isolated_votes = 2;
};

}  // namespace docdepth
