#include "docdepth/render/velocity_estimator.hpp"

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/rigid.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

bool are_close(const Box& a, const Box& b) {
  return ((a.center - b.center).array().abs() <= (a.extent + b.extent).array() + kPartDistance)
      .all();
}

}  // namespace

VelocityEstimator::VelocityEstimator(const DynamicObjects& objects,
                                     const std::vector<VisibilitySweep>& sweeps,
                                     const std::vector<std::uint8_t>& wanted, int threads)
    : objects_(objects),
      sweeps_(sweeps),
      threads_(threads),
      unverified_(wanted),
      velocities_(wanted.size(), Vector::Zero()),
      scores_(wanted.size(), -2) {}

/// Mean over samples and sweeps of 1 where a ray ended on the moved sample, -1 where it passed.
float VelocityEstimator::score_of(std::size_t object, const Vector& velocity) const {
  const auto& samples = objects_.samples[object];
  const std::size_t step = 1 + (samples.size() - 1) / kVerifiedSamples;
  float sum = 0, count = 0;
  for (const VisibilitySweep& sweep : sweeps_) {
    const RigidTransform T(sweep.motion.T_from_to.inverse());
    const Vector shift = velocity * sweep.motion.duration;
    PointBatch there;
    for (std::size_t i = 0; i < samples.size(); i += step) {
      const Vector p = T * (samples[i] + shift);
      there.x[there.size] = p.x(), there.y[there.size] = p.y(), there.z[there.size] = p.z();
      ++there.size;
    }
    float scores[PointBatch::kMax] = {};
    sweep.rays->query_visibility(there, kRayBlur, scores);
    for (std::size_t i = 0; i < there.size; ++i)
      sum += float(scores[i] > kVerifyingScore) - float(scores[i] < -kVerifyingScore);
    count += float(there.size);
  }
  return count > 0 ? sum / count : 1;  // without rays nothing speaks against it
}

void VelocityEstimator::propose_one(std::size_t object, const Vector& velocity) {
  if (velocity.isZero(0)) return;
  if (!velocities_[object].isZero(0) && (velocity - velocities_[object]).norm() < kSameVelocity)
    return;
  const float score = score_of(object, velocity);
  if (!(score > scores_[object])) return;
  velocities_[object] = velocity;
  scores_[object] = score + kScoreGain;
}

void VelocityEstimator::propose(const std::vector<Vector>& velocities) {
  parallel_for(velocities.size(), 1, threads_, [&](std::size_t k, std::size_t) {
    if (!unverified_[k]) return;
    propose_one(k, velocities[k]);
    if (velocities_[k].isZero(0)) scores_[k] = kMinScore;
    unverified_[k] = scores_[k] < kVerifiedScore;
  });
}

void VelocityEstimator::propose_neighbors() {
  const std::vector<Vector> known = velocities_;
  const std::vector<Box> boxes = objects_.boxes();
  parallel_for(known.size(), 1, threads_, [&](std::size_t k, std::size_t) {
    for (std::size_t j = 0; unverified_[k] && j < known.size(); ++j)
      if (are_close(boxes[j], boxes[k])) propose_one(k, known[j]);
  });
}

}  // namespace docdepth
