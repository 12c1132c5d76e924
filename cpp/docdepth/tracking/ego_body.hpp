// What a LiDAR sees of the vehicle that carries it.
#pragma once

#include <cstddef>
#include <vector>

#include "docdepth/detections/detections.hpp"

namespace docdepth {

/// Places beside the LiDAR, in its own frame, where it sees something nearly always, wherever it
/// is in the world: a mirror, a rack, a driver's shoulder.
class EgoBody {
 public:
  /// Look at the next sweep.
  void add(const Detections& seen);
  /// Whether an object is at such a place, by all sweeps that were added.
  bool contains(const Detection& object) const;

 private:
  struct Place {
    Eigen::Vector3f middle;  ///< in the LiDAR frame
    Extent where;            ///< in the world
    std::size_t sweeps = 0, last = 0;
  };

  std::vector<Place> places_;  ///< kSamePlace apart at least
  std::size_t sweeps_ = 0;
};

}  // namespace docdepth
