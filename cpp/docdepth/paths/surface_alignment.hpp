// Surfaces of one rigid object aligned with each other.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <unordered_map>
#include <vector>

#include "docdepth/geometry/sampled_points.hpp"
#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// What a sweep saw of an object. Times are those after its observation [s].
struct ObservedSurface : TimedSurface {
  TimedPoints edges, hidden;  ///< as in Detection

  /// All at the time of the observation: a sweep takes a tenth of a second, in which the far end
  /// of a lorry beside us has moved on by half a metre.
  ObservedSurface deskewed(const Eigen::Vector3f& velocity) const;
};

/// Where the ends of an object are along its x axis, if they are seen.
struct Ends {
  std::optional<float> low, high;
};

/// What several sweeps saw of an object, in its own frame: x forward, z up.
class SurfaceModel {
 public:
  /// @param voxel  edge of the voxels that keep one sample each [m]
  explicit SurfaceModel(float voxel) : voxel_(voxel) {}

  void add(const ObservedSurface& seen, const Pose& T_world_object);

  const SampledSurface& surface() const { return surface_; }
  /// How many surfaces met the voxel of each sample.
  const std::vector<int>& hits() const { return hits_; }
  /// The median of the ends of all surfaces that showed them.
  Ends ends() const;

 private:
  float voxel_;
  SampledSurface surface_;
  std::vector<int> hits_, last_;  // of each sample: surfaces, and the number of the last
  std::unordered_map<std::uint64_t, std::size_t> numbers_;
  int added_ = 0;
  std::vector<float> ends_[2];  ///< low and high, of each surface that showed them
};

/// Where an object may be before its surface is looked at.
struct ExpectedPose {
  Pose T_world_object;
  Eigen::Matrix3d covariance;  ///< of its position in the world [m^2]
  double heading_variance;     ///< [rad^2]
};

struct AlignmentOptions {
  /// Distance of samples from the plane of their partners [m]. It is that of noise and curvature,
  /// times ten, since neighbouring samples err alike.
  double residual_deviation = 0.2;
  /// Weight of the horizontal distance between partners, beside their distance across the surface,
  double point_weight = 0.003;
  /// and where the plane of one of them is not known.
  double lone_point_weight = 0.1;
  /// Surfaces are known this exactly at best [m].
  double surface_deviation = 0.02;
};

struct SurfaceAlignment {
  Pose T_world_object;         ///< by the surface and by what was expected
  Eigen::Vector3d position;    ///< by the surface alone
  Eigen::Matrix3d covariance;  ///< of it in the world, vast where the surface tells nothing [m^2]
  double heading;              ///< by the surface alone [rad]
  double heading_variance;     ///< of it [rad^2]
  float share;                 ///< of the samples that found a partner in the model
};

/// Move a surface onto a model: point to plane, with three translations and the heading.
SurfaceAlignment align_surface(const ObservedSurface& seen, const SurfaceModel& model,
                               const ExpectedPose& expected, const AlignmentOptions& options = {});

double heading_of(const Pose& T);

}  // namespace docdepth
