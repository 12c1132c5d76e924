// Surfaces of one rigid object registered onto each other.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// What several sweeps saw of an object, in its own frame: x forward, z up.
class SurfaceModel {
 public:
  /// @param voxel  edge of the voxels that keep one sample each [m]
  explicit SurfaceModel(float voxel) : voxel_(voxel) {}

  void add(const SampledSurface& seen, const Pose& T_world_object);

  const SampledSurface& surface() const { return surface_; }
  /// How many surfaces met the voxel of each sample.
  const std::vector<int>& hits() const { return hits_; }

 private:
  float voxel_;
  SampledSurface surface_;
  std::vector<int> hits_, last_;  // of each sample: surfaces, and the number of the last
  std::unordered_map<std::uint64_t, std::size_t> numbers_;
  int added_ = 0;
};

struct Registration {
  Pose T_world_object;
  Eigen::Matrix3d covariance;  ///< of the position in the world [m^2]
  double heading_variance;     ///< [rad^2]
  float share;                 ///< of the samples that found a partner in the model
};

/// Move a surface onto a model: point to plane, with three translations and the heading. Directions
/// that the surface does not tell stay near the guess.
Registration register_surface(const SampledSurface& seen, const SurfaceModel& model,
                              const Pose& guess);

}  // namespace docdepth
