// The detections of a sweep that are found by their place.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/detections/detections.hpp"
#include "docdepth/geometry/box_tree.hpp"

namespace docdepth {

/// Finds the detections of a sweep that may be at a place. Whether they are is left to the caller.
class DetectionIndex {
 public:
  /// @param detections  must outlive the index
  explicit DetectionIndex(const Detections& detections);

  const Detections& detections() const { return *detections_; }

  /// Indices of those whose boxes may come within `margin` of a box [m] where they are at a time
  /// after the stamp of the sweep [s], if they go with a velocity; ascending.
  std::vector<std::uint32_t> near(const Extent& box, float margin,
                                  const Eigen::Vector3f& velocity = Eigen::Vector3f::Zero(),
                                  float time = 0) const;

 private:
  const Detections* detections_;
  BoxTree boxes_;
  float first_ = 0, last_ = 0;  ///< time offsets of all detections
};

}  // namespace docdepth
