// What the core refuses at its border, in one place: numbers that cannot be computed with, held or
// finished. Without these checks they end in a crash or run for ever. The ranges are wider than
// those of config.py, which are for users.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <sstream>
#include <stdexcept>

#include "docdepth/dynamics/mesh_image.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/ground/ground.hpp"
#include "docdepth/mesh/scan_mesh.hpp"
#include "docdepth/objects/parameters.hpp"
#include "docdepth/objects/tracking.hpp"

namespace docdepth::bindings {

constexpr int kMaxThreads = 256;
constexpr int kMaxSide = 1 << 16;              ///< of an image [pixel]
constexpr std::int64_t kMaxPixels = 1 << 27;   ///< a depth map of 512 MB
constexpr double kMaxTranslation = 1e8;        ///< of a pose [m]: beyond UTM coordinates
constexpr double kMaxFocalLength = 1e6;        ///< [pixel]
constexpr double kOrthogonal = 1e-3;           ///< of rotations, as in geometry/se3.py
constexpr double kMaxDuration = 1e9;           ///< between sweeps [s]
constexpr std::int64_t kMaxRows = 0x7fffffff;  ///< rows are numbered by 32 bits
constexpr double kMinResolution = 5e-4;        ///< of a key frame [rad]: 2 GB at most
constexpr int kMaxWindow = 63;                 ///< of a key frame [pixel]
constexpr double kMaxShiftOfTrack = 1000.0;    ///< max_speed times max_gap [m]
constexpr double kMaxSplat = 2048.0;           ///< height of a splat [pixel]

constexpr double kMaxSplatPixels = 2147483648.0;  ///< of all heights together: 8 GB

/// @throws std::invalid_argument the number is outside of its range, or not a number
template <class Number>
Number in_range(Number value, double low, double high, const char* name) {
  if (static_cast<double>(value) >= low && static_cast<double>(value) <= high) return value;
  std::ostringstream text;
  text << name << " = " << value << " must lie between " << low << " and " << high;
  throw std::invalid_argument(text.str());
}

/// A number of threads; 0 or less is all cores.
inline int checked_threads(int threads) {
  return threads > 0 ? static_cast<int>(in_range(threads, 1, kMaxThreads, "threads")) : 0;
}

inline const Pose& checked(const Pose& pose) {
  const auto& matrix = pose.matrix();
  const Eigen::Matrix3d gram = pose.linear() * pose.linear().transpose();
  const bool rigid = matrix.allFinite() && matrix.row(3) == Eigen::RowVector4d(0, 0, 0, 1) &&
                     (gram - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() < kOrthogonal &&
                     pose.linear().determinant() > 0 &&
                     pose.translation().cwiseAbs().maxCoeff() < kMaxTranslation;
  if (!rigid) throw std::invalid_argument("a pose is not a rotation and a translation in metres");
  return pose;
}

inline const GroundParameters& checked(const GroundParameters& p) {
  in_range(p.voxel_size, 1e-3, 100, "voxel_size");
  in_range(p.seed_radius, 1e-3, 1e4, "seed_radius");
  in_range(p.seed_quantile, 0, 1, "seed_quantile");
  in_range(p.least_share, 0, 1, "least_share");
  in_range(p.neighbors, 1, 1000, "neighbors");
  in_range(p.plane_distance, 0, 1e4, "plane_distance");
  in_range(p.max_slope, 0, 1.58, "max_slope");
  in_range(p.step_height, 0, 1e4, "step_height");
  return p;
}

inline const MeshParameters& checked(const MeshParameters& p) {
  in_range(p.max_gap, 0, 10, "max_gap");
  in_range(p.jump_ratio, 0, 1e9, "jump_ratio");
  in_range(p.noise, 0, 1e9, "noise");
  in_range(p.flatness, 0, 1e9, "flatness");
  return p;
}

inline void check_key_frame(double resolution, int window, float tolerance) {
  in_range(resolution, kMinResolution, 1, "resolution");
  in_range(window, 1, kMaxWindow, "window");
  in_range(tolerance, 1e-6, 1e4, "tolerance");
}

inline const Margins& checked(const Margins& m) {
  in_range(m.normal_tolerance, 0, 1e9, "normal_tolerance");
  in_range(m.radial_tolerance, 0, 1e9, "radial_tolerance");
  in_range(m.radial_growth, 0, 1e9, "radial_growth");
  return m;
}

inline const MeshImageParameters& checked(const MeshImageParameters& p) {
  check_key_frame(p.resolution, p.window, p.tolerance);
  checked(p.upright), checked(p.level);
  in_range(p.ground_tolerance, 0, 1e9, "ground_tolerance");
  in_range(p.level_cosine, -1, 1, "level_cosine");
  in_range(p.max_ray_distance, 0, 1e9, "max_ray_distance");
  return p;
}

inline const ObjectParameters& checked(const ObjectParameters& p) {
  in_range(p.cluster_distance, 0, 1e9, "cluster_distance");
  in_range(p.cluster_distance_growth, 0, 1e9, "cluster_distance_growth");
  in_range(p.min_cluster_size, 0, 1e9, "min_cluster_size");
  in_range(p.neighbor_radius, 1e-3, 1e6, "neighbor_radius");
  in_range(p.clear_votes, 0, 1e6, "clear_votes");
  in_range(p.clear_ratio, 0, 1e9, "clear_ratio");
  in_range(p.min_object_points, 0, 1e9, "min_object_points");
  in_range(p.dynamic_share, 0, 1, "dynamic_share");
  in_range(p.min_dynamic_share, 0, 1, "min_dynamic_share");
  in_range(p.min_object_width, 0, 1e9, "min_object_width");
  in_range(p.min_object_height, 0, 1e9, "min_object_height");
  in_range(p.observed_free_share, 0, 1, "observed_free_share");
  in_range(p.observed_free_votes, 0, 1e6, "observed_free_votes");
  in_range(p.max_static_ratio, 0, 1e9, "max_static_ratio");
  in_range(p.isolated_votes, 0, 1e6, "isolated_votes");
  return p;
}

inline const TrackParameters& checked(const TrackParameters& p) {
  in_range(p.min_detections, 0, 1e6, "min_detections");
  in_range(p.min_distance, 0, 1e9, "min_distance");
  in_range(p.max_speed, 0, 1e3, "max_speed");
  in_range(p.max_gap, 0, 1e3, "max_gap");
  in_range(p.max_gap_standing, 0, 1e3, "max_gap_standing");
  in_range(p.max_speed * std::max(p.max_gap, p.max_gap_standing), 0, kMaxShiftOfTrack,
           "max_speed times max_gap");
  in_range(p.window, 0, 1e3, "window");
  return p;
}

}  // namespace docdepth::bindings
