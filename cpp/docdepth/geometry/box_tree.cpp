#include "docdepth/geometry/box_tree.hpp"

#include <algorithm>
#include <numeric>

namespace docdepth {
namespace {

/// So few boxes are looked at one by one.
constexpr std::uint32_t kBoxesInLeaf = 8;

}  // namespace

BoxTree::BoxTree(const std::vector<Extent>& boxes) : boxes_(boxes), order_(boxes.size()) {
  std::iota(order_.begin(), order_.end(), 0u);
  if (!boxes_.empty()) add(0, std::uint32_t(boxes_.size()));
}

std::uint32_t BoxTree::add(std::uint32_t begin, std::uint32_t end) {
  const auto number = std::uint32_t(nodes_.size());
  Extent around = boxes_[order_[begin]];
  for (std::uint32_t n = begin; n < end; ++n) around.add(boxes_[order_[n]]);
  nodes_.push_back({around, begin, end});
  if (end - begin <= kBoxesInLeaf) return number;
  Eigen::Index axis = 0;
  around.size().maxCoeff(&axis);
  const auto middle_of = [&](std::uint32_t k) {
    return boxes_[k].low[axis] + boxes_[k].high[axis];
  };
  const std::uint32_t half = begin + (end - begin) / 2;
  std::nth_element(order_.begin() + begin, order_.begin() + half, order_.begin() + end,
                   [&](auto a, auto b) { return middle_of(a) < middle_of(b); });
  add(begin, half);
  const std::uint32_t other = add(half, end);
  nodes_[number].other = other;
  return number;
}

std::vector<std::uint32_t> BoxTree::near(const Extent& box, float margin) const {
  std::vector<std::uint32_t> found;
  if (!nodes_.empty()) find(0, box, margin, found);
  std::sort(found.begin(), found.end());
  return found;
}

void BoxTree::find(std::uint32_t number, const Extent& box, float margin,
                   std::vector<std::uint32_t>& found) const {
  const Node& node = nodes_[number];
  if (!node.around.overlaps(box, margin)) return;
  if (node.other > 0) {
    find(number + 1, box, margin, found);
    find(node.other, box, margin, found);
    return;
  }
  for (std::uint32_t n = node.begin; n < node.end; ++n)
    if (boxes_[order_[n]].overlaps(box, margin)) found.push_back(order_[n]);
}

}  // namespace docdepth
