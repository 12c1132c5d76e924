#include "docdepth/tracking/neighbors.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "docdepth/tracking/constants.hpp"

namespace docdepth {
namespace {

/// Two parts belong together if their transient shares differ by less than this factor.
constexpr float kTogetherShare = 0.35f;
/// So many directions are tried for the width of things.
constexpr int kWidthDirections = 18;

/// Whether the place of a detection was less free than that of another one, and the votes tell that
/// it was there before or stayed after.
bool was_there_before(const Detection& object, const Detection& other) {
  return was_less_free(object, other.transient_share()) &&
         (other.is_transient() || object.first_occupied < other.first_occupied ||
          object.last_occupied > other.last_occupied);
}

}  // namespace

bool are_too_wide(std::initializer_list<const SampledPoints*> things) {
  for (int i = 0; i < kWidthDirections; ++i) {
    const double angle = M_PI * i / kWidthDirections;
    const Eigen::Vector2f across(float(std::cos(angle)), float(std::sin(angle)));
    float low = std::numeric_limits<float>::infinity(), high = -low;
    for (const SampledPoints* samples : things)
      for (const Eigen::Vector3f& p : *samples) {
        const float x = across.dot(p.head<2>());
        low = std::min(low, x);
        high = std::max(high, x);
      }
    if (high - low <= kMaxVehicleWidth) return false;
  }
  return true;
}

bool was_less_free(const Detection& object, float share) {
  return object.transient_share() < kTogetherShare * share;
}

SampledPoints drop_neighbors(const Detections& seen, std::vector<std::uint32_t>& chosen) {
  SampledPoints neighbors;
  if (chosen.empty()) return neighbors;
  const auto best = *std::max_element(chosen.begin(), chosen.end(), [&](auto a, auto b) {
    return seen[a].transient_area() < seen[b].transient_area();
  });
  const auto is_neighbor = [&](std::uint32_t k) {
    const SampledPoints& samples = seen[k].samples();
    if (k == best ||
        !(was_there_before(seen[k], seen[best]) || are_too_wide({&samples, &seen[best].samples()})))
      return false;
    neighbors.insert(neighbors.end(), samples.begin(), samples.end());
    return true;
  };
  chosen.erase(std::remove_if(chosen.begin(), chosen.end(), is_neighbor), chosen.end());
  return neighbors;
}

bool is_among(const Detection& object, const SampledPoints& neighbors) {
  return !neighbors.empty() &&
         matched_share(object.samples(), Eigen::Vector3f::Zero(), neighbors) >= kMinMemberShare;
}

}  // namespace docdepth
