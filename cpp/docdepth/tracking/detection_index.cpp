#include "docdepth/tracking/detection_index.hpp"

#include <algorithm>
#include <cmath>

namespace docdepth {
namespace {

/// How much rounding may move a box [m], with coordinates up to 1000 km.
constexpr float kRounding = 0.2f;

std::vector<Extent> boxes_of(const Detections& detections) {
  std::vector<Extent> boxes;
  for (const Detection& object : detections) boxes.push_back(object.box);
  return boxes;
}

}  // namespace

DetectionIndex::DetectionIndex(const Detections& detections)
    : detections_(&detections), boxes_(boxes_of(detections)) {
  for (const Detection& object : detections) {
    first_ = std::min(first_, object.time_offset);
    last_ = std::max(last_, object.time_offset);
  }
}

std::vector<std::uint32_t> DetectionIndex::near(const Extent& box, float margin,
                                                const Eigen::Vector3f& velocity, float time) const {
  const float apart = std::max(std::fabs(time - first_), std::fabs(time - last_));
  return boxes_.near(box, margin + apart * velocity.norm() + kRounding);
}

}  // namespace docdepth
