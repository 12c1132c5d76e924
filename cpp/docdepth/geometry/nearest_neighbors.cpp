#include "docdepth/geometry/nearest_neighbors.hpp"

#include <cmath>
#include <limits>
#include <nanoflann.hpp>
#include <stdexcept>
#include <string>

#include "docdepth/geometry/parallel.hpp"

namespace docdepth {
namespace {

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

/// Squares of larger coordinates overflow a float [m].
constexpr float kMaxCoordinate = 1e18f;

/// Branches whose bound exceeds the least squared distance by less are searched, too.
constexpr float kBoundMargin = 1.00001f;
/// Queries that a thread takes at once.
constexpr std::size_t kQueryBlock = 1024;
/// Keeps the nearest point, of equally near ones the first: branches that may hold an equal
/// distance are searched, too.
class FirstNearest {
 public:
  using DistanceType = float;
  using IndexType = std::uint32_t;

  std::uint32_t index() const { return index_; }
  float squared() const { return squared_; }

  // The interface of nanoflann's result sets.
  bool full() const { return found_; }
  bool empty() const { return !found_; }
  std::size_t size() const { return found_; }
  void sort() {}
  float worstDist() const {
    return std::nextafter(squared_ * kBoundMargin, std::numeric_limits<float>::infinity());
  }
  bool addPoint(float squared, std::uint32_t index) {
    if (!found_ || squared < squared_ || (squared == squared_ && index < index_)) {
      squared_ = squared;
      index_ = index;
    }
    found_ = true;
    return true;
  }

 private:
  bool found_ = false;
  std::uint32_t index_ = 0;
  float squared_ = std::numeric_limits<float>::max();
};

void check(const Points& points, const char* name) {
  for (Eigen::Index i = 0; i < points.rows(); ++i)
    for (int axis = 0; axis < 3; ++axis)
      if (!(std::fabs(points(i, axis)) < kMaxCoordinate))
        throw std::invalid_argument(std::string(name) + " must be finite, but row " +
                                    std::to_string(i) + " is not");
}

}  // namespace

NearestNeighbors nearest_neighbors(const Points& points, const Points& queries, int threads) {
  check(points, "points");
  check(queries, "queries");
  const auto count = static_cast<std::size_t>(queries.rows());
  NearestNeighbors found{std::vector<std::uint32_t>(count), std::vector<float>(count)};
  if (!count) return found;
  if (!points.rows()) throw std::invalid_argument("there are no points to search in");
  const PointsAdaptor adaptor(points);
  const KdTree tree(3, adaptor, {kTreeLeafSize});
  parallel_for(count, kQueryBlock, threads, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      const float query[3] = {queries(row, 0), queries(row, 1), queries(row, 2)};
      FirstNearest nearest;
      tree.findNeighbors(nearest, query, {});
      found.index[i] = nearest.index();
      found.distance[i] = std::sqrt(nearest.squared());
    }
  });
  return found;
}

}  // namespace docdepth
