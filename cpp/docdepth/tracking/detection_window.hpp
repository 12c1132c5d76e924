// Detections of a drive that wait on disk until they are looked at.
#pragma once

#include <cstddef>
#include <deque>
#include <functional>
#include <memory>
#include <utility>

#include "docdepth/detections/detections.hpp"

namespace docdepth {

/// Gives the detections of a sweep. It is called from the thread that tracks, and may be asked for
/// a sweep several times.
using ReadDetections = std::function<std::shared_ptr<const Detections>(std::size_t sweep)>;

/// The detections that were asked for last. So memory does not grow with the drive.
class DetectionWindow {
 public:
  /// @param size  so many sweeps, at least 1
  DetectionWindow(ReadDetections read, std::size_t size) : read_(std::move(read)), size_(size) {}

  std::shared_ptr<const Detections> operator()(std::size_t sweep) {
    for (auto it = recent_.rbegin(); it != recent_.rend(); ++it)
      if (it->first == sweep) return it->second;
    if (recent_.size() == size_) recent_.pop_front();
    recent_.emplace_back(sweep, read_(sweep));
    return recent_.back().second;
  }

 private:
  ReadDetections read_;
  std::size_t size_;
  std::deque<std::pair<std::size_t, std::shared_ptr<const Detections>>> recent_;
};

}  // namespace docdepth
