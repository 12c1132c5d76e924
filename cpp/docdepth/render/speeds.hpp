// How fast moving objects are, as far as the rays of other sweeps bear it out.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/motion.hpp"
#include "docdepth/render/rays.hpp"

namespace docdepth {

/// The rays of another sweep, and the way there.
struct Witness {
  const Rays* rays;
  Passage passage;
};

/// The velocity of each object, of all that are offered for it.
///
/// Matching an object with what another sweep saw of it goes wrong where something before it hides
/// its ends: what is seen past a post seems to stand. The rays know: where a car is said to be,
/// none may have gone through.
class Speeds {
 public:
  /// All must live as long.
  /// @param wanted 1 for each object whose velocity is asked for
  Speeds(const Objects& objects, const std::vector<Witness>& witnesses,
         const std::vector<std::uint8_t>& wanted, int threads);

  /// 1 for each object that is asked for whose velocity is not well borne out.
  const std::vector<std::uint8_t>& doubted() const { return doubted_; }

  /// Takes those that are borne out better; a zero says nothing.
  void offer(const std::vector<Eigen::Vector3f>& velocities);

  /// Offers doubted objects the velocities of those beside them: they may be parts of one.
  void offer_around();

  const std::vector<Eigen::Vector3f>& velocities() const { return velocities_; }

 private:
  float borne_out(std::size_t object, const Eigen::Vector3f& velocity) const;
  void offer_one(std::size_t object, const Eigen::Vector3f& velocity);

  const Objects& objects_;
  const std::vector<Witness>& witnesses_;
  int threads_;
  std::vector<std::uint8_t> doubted_;
  std::vector<Eigen::Vector3f> velocities_;
  std::vector<float> scores_;  ///< to be beaten
};

}  // namespace docdepth
