#include "docdepth/geometry/neighborhoods.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstring>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/simd.hpp"

namespace docdepth {
namespace {

constexpr float kFar = INFINITY;
/// Points of a leaf: one for each lane.
constexpr std::uint32_t kLeaf = kLanes;
/// Leaves that a thread takes at once.
constexpr std::size_t kLeavesAtOnce = 32;

struct Node {
  std::array<float, 3> low, high;  // of the points
  std::uint32_t begin, end;        // points
  std::uint32_t right;             // the left child follows; 0 for a leaf
};

/// A k-d tree. Its points lie in the order of the leaves, and all leaves but the last are full.
class Tree {
 public:
  explicit Tree(const Points& points) : items_(static_cast<std::size_t>(points.rows())) {
    for (std::size_t i = 0; i < items_.size(); ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      items_[i] = {{points(row, 0), points(row, 1), points(row, 2)}, std::uint32_t(i)};
    }
    for (auto& axis : columns_)
      axis.assign(items_.size() + kLanes, kFar);  // whole vectors are read
    if (!items_.empty()) build(0, static_cast<std::uint32_t>(items_.size()));
    for (std::size_t i = 0; i < items_.size(); ++i)
      for (int axis = 0; axis < 3; ++axis) columns_[axis][i] = items_[i].at[axis];
  }

  const std::vector<Node>& nodes() const { return nodes_; }
  const std::vector<std::uint32_t>& leaves() const { return leaves_; }
  const float* column(int axis) const { return columns_[axis].data(); }
  std::uint32_t row(std::uint32_t point) const { return items_[point].row; }
  std::size_t size() const { return items_.size(); }

 private:
  struct Item {
    std::array<float, 3> at;
    std::uint32_t row;
  };

  void build(std::uint32_t begin, std::uint32_t end) {
    const std::size_t number = nodes_.size();
    Node node{items_[begin].at, items_[begin].at, begin, end, 0};
    for (std::uint32_t i = begin; i < end; ++i)
      for (int axis = 0; axis < 3; ++axis) {
        node.low[axis] = std::min(node.low[axis], items_[i].at[axis]);
        node.high[axis] = std::max(node.high[axis], items_[i].at[axis]);
      }
    nodes_.push_back(node);
    if (end - begin <= kLeaf) {
      leaves_.push_back(static_cast<std::uint32_t>(number));
      return;
    }
    int widest = 0;
    for (int axis = 1; axis < 3; ++axis)
      if (node.high[axis] - node.low[axis] > node.high[widest] - node.low[widest]) widest = axis;
    const std::uint32_t half = (end - begin + 1) / 2;
    const std::uint32_t middle = begin + (half + kLeaf - 1) / kLeaf * kLeaf;
    std::nth_element(
        items_.begin() + begin, items_.begin() + middle, items_.begin() + end,
        [widest](const Item& a, const Item& b) { return a.at[widest] < b.at[widest]; });
    build(begin, middle);
    nodes_[number].right = static_cast<std::uint32_t>(nodes_.size());
    build(middle, end);
  }

  std::vector<Item> items_;
  std::vector<Node> nodes_;
  std::vector<std::uint32_t> leaves_;
  std::array<std::vector<float>, 3> columns_;
};

/// Squared distance of two boxes. As rounding keeps order, no two points of them are nearer.
DOCDEPTH_KERNEL float squared_between(const Node& a, const Node& b) {
  float sum = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const float gap = std::max(a.low[axis] - b.high[axis], b.low[axis] - a.high[axis]);
    sum += gap > 0 ? gap * gap : 0;
  }
  return sum;
}

using Words = std::uint64_t __attribute__((vector_size(8 * kDoubleLanes)));
using HalfWords = std::uint32_t __attribute__((vector_size(4 * kDoubleLanes)));
constexpr int kHalves = kLanes / kDoubleLanes;

/// Added to the bits of a pair: numbers below are slow.
constexpr std::uint64_t kLeastNormal = std::uint64_t{1} << 52;

/// Squared distances and a row, each pair as one double: bits of floats, and of doubles, that are
/// not negative are in the order of their values.
DOCDEPTH_KERNEL void pairs_of(const Floats& squared, std::uint32_t row, Doubles pairs[kHalves]) {
  HalfWords bits[kHalves];
  std::memcpy(bits, &squared, sizeof bits);
  for (int h = 0; h < kHalves; ++h) {
    const Words words = (__builtin_convertvector(bits[h], Words) << 32) + (kLeastNormal + row);
    std::memcpy(&pairs[h], &words, sizeof words);
  }
}
DOCDEPTH_KERNEL Floats squared_of(const double* pairs) {
  HalfWords bits[kHalves];
  for (int h = 0; h < kHalves; ++h)
    bits[h] = __builtin_convertvector((load<Words>(pairs + h * kDoubleLanes) - kLeastNormal) >> 32,
                                      HalfWords);
  Floats squared;
  std::memcpy(&squared, bits, sizeof squared);
  return squared;
}
std::uint32_t row_of(double pair) {
  return static_cast<std::uint32_t>(std::bit_cast<std::uint64_t>(pair));
}

/// The nearest points of the points of a leaf, all of which are searched for at once.
struct FindNearest {
  /// @param nearest  receives pairs: those of the nearest points, of the next ones, and so on
  DOCDEPTH_KERNEL static void run(const Tree& tree, const Node& leaf, std::size_t count,
                                  double* nearest) {
    const float *x = tree.column(0), *y = tree.column(1), *z = tree.column(2);
    const Floats own_x = load(x + leaf.begin), own_y = load(y + leaf.begin),
                 own_z = load(z + leaf.begin);
    Floats worst{};  // nothing is near to lanes without a point
    for (std::uint32_t lane = 0; lane < kLeaf; ++lane)
      worst[lane] = lane < leaf.end - leaf.begin ? kFar : -1.0f;
    const Floats used = worst;
    Doubles pairs[kHalves];
    pairs_of(Floats{} + kFar, 0, pairs);
    double* const last = nearest + (count - 1) * kLanes;
    for (double* kept = nearest; kept < last + kLanes; kept += kDoubleLanes) store(pairs[0], kept);
    float most = kFar;
    struct Branch {
      const Node* node;
      float squared;
    };
    std::array<Branch, 64> left;  // the tree is not so deep
    std::size_t branches = 0;
    left[branches++] = {tree.nodes().data(), 0.0f};
    while (branches) {
      auto [node, squared] = left[--branches];
      while (squared <= most && node->right) {
        Branch near{node + 1, squared_between(node[1], leaf)};
        Branch far{&tree.nodes()[node->right], 0.0f};
        far.squared = squared_between(*far.node, leaf);
        const bool is_own = leaf.begin >= far.node->begin;
        if (far.squared < near.squared || (far.squared == near.squared && is_own))
          std::swap(near, far);
        left[branches++] = far;
        node = near.node;
        squared = near.squared;
      }
      if (squared > most) continue;
      for (std::uint32_t i = node->begin; i < node->end; ++i) {
        const Floats dx = own_x - x[i], dy = own_y - y[i], dz = own_z - z[i];
        const Floats apart = (dx * dx + dy * dy) + dz * dz;
        if (!any(apart <= worst)) continue;
        pairs_of(apart, tree.row(i), pairs);
        for (double* kept = nearest; kept <= last; kept += kLanes)
          for (int h = 0; h < kHalves; ++h) {
            const Doubles old = load<Doubles>(kept + h * kDoubleLanes), in = pairs[h];
            store(in < old ? in : old, kept + h * kDoubleLanes);
            pairs[h] = in < old ? old : in;
          }
        worst = squared_of(last);
        worst = worst < used ? worst : used;
      }
      most = -1.0f;
      for (int lane = 0; lane < kLanes; ++lane) most = std::max(most, float(worst[lane]));
    }
  }
};

}  // namespace

void for_each_neighborhood(const Points& points, int count, int threads,
                           const UseNeighborhood& use) {
  const Tree tree(points);
  const std::size_t size = std::min(static_cast<std::size_t>(count), tree.size());
  if (!size) return;
  parallel_for(tree.leaves().size(), kLeavesAtOnce, threads,
               [&](std::size_t begin, std::size_t end) {
                 std::vector<double> nearest(size * kLanes);
                 std::vector<std::uint32_t> rows(size);
                 for (std::size_t l = begin; l < end; ++l) {
                   const Node& leaf = tree.nodes()[tree.leaves()[l]];
                   dispatch<FindNearest>(tree, leaf, size, nearest.data());
                   for (std::uint32_t i = leaf.begin; i < leaf.end; ++i) {
                     for (std::size_t k = 0; k < size; ++k)
                       rows[k] = row_of(nearest[k * kLanes + (i - leaf.begin)]);
                     use(tree.row(i), rows);
                   }
                 }
               });
}

}  // namespace docdepth
