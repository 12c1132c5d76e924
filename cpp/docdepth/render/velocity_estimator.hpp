// The velocity of dynamic objects, verified by the rays of other sweeps.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/motion.hpp"
#include "docdepth/render/rays.hpp"

namespace docdepth {

/// A sweep whose rays verify velocities.
struct VisibilitySweep {
  const Rays* rays;
  RelativeMotion motion;  ///< to this sweep
};

/// Chooses among the velocities that are proposed for each object.
///
/// Matching goes wrong where an occluder hides the ends of an object: what is visible past a post
/// seems to stand still. Rays correct it: none passes through a car.
class VelocityEstimator {
 public:
  /// The arguments must outlive the estimator.
  /// @param wanted  1 for each object whose velocity is needed
  VelocityEstimator(const DynamicObjects& objects, const std::vector<VisibilitySweep>& sweeps,
                    const std::vector<std::uint8_t>& wanted, int threads);

  /// 1 for each wanted object whose velocity is not verified yet.
  const std::vector<std::uint8_t>& unverified() const { return unverified_; }

  /// Take those velocities that score better. A zero proposes nothing.
  void propose(const std::vector<Eigen::Vector3f>& velocities);

  /// Propose to unverified objects the velocities of their neighbours: they may be parts of one.
  void propose_neighbors();

  const std::vector<Eigen::Vector3f>& velocities() const { return velocities_; }

 private:
  float score_of(std::size_t object, const Eigen::Vector3f& velocity) const;
  void propose_one(std::size_t object, const Eigen::Vector3f& velocity);

  const DynamicObjects& objects_;
  const std::vector<VisibilitySweep>& sweeps_;
  int threads_;
  std::vector<std::uint8_t> unverified_;
  std::vector<Eigen::Vector3f> velocities_;
  std::vector<float> scores_;  ///< that a proposal has to beat
};

}  // namespace docdepth
