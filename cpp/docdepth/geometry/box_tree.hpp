// Boxes that are found by their place.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/geometry/sampled_points.hpp"

namespace docdepth {

/// Boxes in a binary tree: those at a place are found without a look at all of them, whatever their
/// sizes.
class BoxTree {
 public:
  BoxTree() = default;
  explicit BoxTree(const std::vector<Extent>& boxes);

  /// Indices of the boxes that overlap a box or come within `margin` of it [m], ascending.
  std::vector<std::uint32_t> near(const Extent& box, float margin) const;

 private:
  /// Around some boxes, and where the branch of the others begins in nodes_.
  struct Node {
    Extent around;
    std::uint32_t begin, end;  ///< in order_
    std::uint32_t other = 0;   ///< 0 of a leaf; its first branch follows the node
  };

  std::uint32_t add(std::uint32_t begin, std::uint32_t end);
  void find(std::uint32_t node, const Extent& box, float margin,
            std::vector<std::uint32_t>& found) const;

  std::vector<Extent> boxes_;
  std::vector<std::uint32_t> order_;  ///< indices of boxes_, leaf after leaf
  std::vector<Node> nodes_;
};

}  // namespace docdepth
