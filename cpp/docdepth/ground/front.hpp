// The front of the ground (paper IV-A): it grows from seeds over flat neighbourhoods.
#pragma once

#include <atomic>
#include <cstdint>
#include <vector>

#include "docdepth/ground/ground.hpp"
#include "docdepth/ground/neighborhood.hpp"
#include "docdepth/ground/octree.hpp"

namespace docdepth {

/// The front of the growing ground: the points that it has reached, which of them have passed it
/// on, and the leaves that hold the others. What it reaches in the end does not depend on the
/// order, so threads take leaves freely.
class Front {
 public:
  /// @param stands  whether the LiDAR stands
  Front(const Octree& tree, const GroundParameters& parameters, bool stands, int threads,
        const std::atomic<bool>& stopped);

  /// Start from a point, where its nearest ones lie on a flat plane.
  void seed(std::uint32_t point);
  /// Pass the front on until it reaches no other point.
  /// @throws std::runtime_error stopped is set
  void grow();
  /// Whether the front has reached a point.
  bool labelled(std::uint32_t point) const {
    return labels_[point].load(std::memory_order_relaxed) != kNone;
  }

 private:
  enum Label : std::uint8_t { kNone, kReached, kDone };
  using Leaves = std::vector<std::uint32_t>;

  void queue(std::uint32_t leaf, Leaves& leaves) {
    if (!queued_[leaf].exchange(1)) leaves.push_back(leaf);
  }
  void spread();
  bool widen();
  Neighborhood::Outcome search(std::uint32_t point, std::uint32_t leaf, Neighborhood& hood,
                               bool always) const;
  bool is_line(Neighborhood& hood) const;
  double first_reach(std::uint32_t leaf) const;
  void visit(std::uint32_t leaf, Neighborhood& hood, Leaves& reached);
  void pass_on(std::uint32_t point, std::uint32_t leaf, Neighborhood& hood,
               std::vector<std::uint32_t>& pending, Leaves& reached);

  const Octree& tree_;
  const GroundParameters& parameters_;
  bool stands_;
  const std::atomic<bool>& stopped_;
  int threads_;
  double cos_max_slope_;
  std::vector<std::atomic<std::uint8_t>> labels_;
  std::vector<std::uint8_t> widened_;  // points of which it is known whether more tell the plane
  std::vector<std::atomic<std::uint8_t>> queued_;  // leaves that wait for a thread
  std::vector<float> reach_;                       // reach that the last visit of a leaf needed
  std::vector<std::uint32_t> seeds_;               // ascending
  Leaves next_;
};

}  // namespace docdepth
