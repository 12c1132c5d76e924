// nanoflann's k-d tree on points where they are. For sources of the core alone.
#pragma once

#include <cstddef>
#include <cstdint>
#include <nanoflann.hpp>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Points in a leaf of a tree: fewer make the tree deeper, more are compared in vain.
constexpr std::size_t kTreeLeafSize = 16;

/// Lets nanoflann read points where they are.
class PointsAdaptor {
 public:
  explicit PointsAdaptor(const Points& points)
      : data_(points.data()),
        stride_(static_cast<std::size_t>(points.outerStride())),
        count_(static_cast<std::size_t>(points.rows())) {}

  // The interface of nanoflann.
  std::size_t kdtree_get_point_count() const { return count_; }
  float kdtree_get_pt(std::size_t i, std::size_t axis) const { return data_[i * stride_ + axis]; }
  template <class Box>
  bool kdtree_get_bbox(Box&) const {
    return false;  // nanoflann computes it
  }

 private:
  const float* data_;
  std::size_t stride_, count_;
};

using KdTree = nanoflann::KDTreeSingleIndexAdaptor<
    nanoflann::L2_Simple_Adaptor<float, PointsAdaptor, float, std::uint32_t>, PointsAdaptor, 3,
    std::uint32_t>;

}  // namespace docdepth
