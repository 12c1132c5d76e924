#include "docdepth/render/speeds.hpp"

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/rigid.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

constexpr std::size_t kSome = 50;  ///< places tell whether a velocity is borne out
constexpr float kClose = 16;       ///< rays tell of a place that they passed within 23 cm
constexpr float kWell = 0.9f;      ///< with this score a velocity is not doubted
constexpr float kBetter = 0.05f;   ///< another one's has to be better by so much
constexpr float kLeast = 0.3f;     ///< or as good, for what was not found again
constexpr float kAlike = 0.3f;     ///< velocities that differ less are not told apart [m/s]
constexpr float kAround = 3;       ///< what is nearer may be another part of the same [m]

bool beside(const Box& a, const Box& b) {
  return ((a.center - b.center).array().abs() <= (a.extent + b.extent).array() + kAround).all();
}

}  // namespace

Speeds::Speeds(const Objects& objects, const std::vector<Witness>& witnesses,
               const std::vector<std::uint8_t>& wanted, int threads)
    : objects_(objects),
      witnesses_(witnesses),
      threads_(threads),
      doubted_(wanted),
      velocities_(wanted.size(), Vector::Zero()),
      scores_(wanted.size(), -2) {}

float Speeds::borne_out(std::size_t object, const Vector& velocity) const {
  const auto& places = objects_.places[object];
  const std::size_t step = 1 + (places.size() - 1) / kSome;
  float sum = 0, asked = 0;
  for (const Witness& witness : witnesses_) {
    const RigidTransform T(witness.passage.T_from_to.inverse());
    const Vector way = velocity * witness.passage.duration;
    Places there;
    for (std::size_t i = 0; i < places.size(); i += step) {
      const Vector p = T * (places[i] + way);
      there.x[there.size] = p.x(), there.y[there.size] = p.y(), there.z[there.size] = p.z();
      ++there.size;
    }
    float told[Places::kMost] = {};
    witness.rays->ask(there, kBlur, told);
    for (std::size_t i = 0; i < there.size; ++i)
      sum += float(told[i] > kClose) - float(told[i] < -kClose);
    asked += float(there.size);
  }
  return asked > 0 ? sum / asked : 1;  // without witnesses there is no doubt
}

void Speeds::offer_one(std::size_t object, const Vector& velocity) {
  if (velocity.isZero(0)) return;
  if (!velocities_[object].isZero(0) && (velocity - velocities_[object]).norm() < kAlike) return;
  const float score = borne_out(object, velocity);
  if (!(score > scores_[object])) return;
  velocities_[object] = velocity;
  scores_[object] = score + kBetter;
}

void Speeds::offer(const std::vector<Vector>& velocities) {
  parallel_for(velocities.size(), 1, threads_, [&](std::size_t k, std::size_t) {
    if (!doubted_[k]) return;
    offer_one(k, velocities[k]);
    if (velocities_[k].isZero(0)) scores_[k] = kLeast;  // of what was not found again
    doubted_[k] = scores_[k] < kWell;
  });
}

void Speeds::offer_around() {
  const std::vector<Vector> known = velocities_;
  const std::vector<Box> boxes = objects_.boxes();
  parallel_for(known.size(), 1, threads_, [&](std::size_t k, std::size_t) {
    for (std::size_t j = 0; doubted_[k] && j < known.size(); ++j)
      if (beside(boxes[j], boxes[k])) offer_one(k, known[j]);
  });
}

}  // namespace docdepth
