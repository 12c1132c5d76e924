// Exact nearest neighbours of the points of a leaf.
#pragma once

#include <Eigen/Geometry>
#include <atomic>
#include <cstdint>
#include <utility>
#include <vector>

#include "docdepth/ground/octree.hpp"

namespace docdepth {

/// All points within a reach of a leaf, laid out for fast distances. Single precision narrows the
/// candidates, double precision decides, so the neighbours are exact.
class Neighborhood {
 public:
  using Labels = std::vector<std::atomic<std::uint8_t>>;

  Neighborhood(const Octree& tree, const Labels& labels, std::size_t k)
      : tree_(tree), labels_(labels), k_(k) {}

  /// Take the points within `reach` of the box of the leaf.
  void gather(std::uint32_t leaf, double reach);

  enum class Outcome {
    kNothingNew,     ///< all neighbours are labelled; the test is cheaper than the search
    kFound,          ///< they are in nearest()
    kReachTooShort,  ///< gather again with needed_reach()
  };
  /// Find the k nearest points of a point of the leaf, including itself.
  /// @param always  also if all of them are labelled
  Outcome search(std::uint32_t point, bool always = false);

  /// DepthHypotheses in the order of their points.
  const std::vector<std::uint32_t>& nearest() const { return nearest_; }
  /// From the point of the last search to its n-th neighbour; the mean of all neighbours; their
  /// covariance around that mean, times their number.
  Eigen::Vector3d offset(std::size_t n) const { return {dx_[n], dy_[n], dz_[n]}; }
  Eigen::Vector3d mean() const;
  Eigen::Matrix3d covariance(const Eigen::Vector3d& mean);
  double reach() const { return reach_; }  ///< of the last `gather`
  /// Reach that the last search needs, or would have needed.
  double needed_reach() const { return needed_reach_; }

  std::uint32_t index(std::uint32_t candidate) const { return index_[candidate]; }
  const Eigen::Vector3d& point(std::uint32_t candidate) const {
    return tree_.points()[index_[candidate]];
  }
  std::uint32_t leaf(std::uint32_t candidate) const;
  /// Whether the candidate had no label when it was gathered and was not closed since.
  bool open(std::uint32_t candidate) const { return closed_[candidate] == 0.f; }
  void close(std::uint32_t candidate);

 private:
  void reserve(std::size_t size);
  float radius_of_k();
  Outcome select(std::uint32_t candidate, float radius);
  void keep_nearest(double last);

  const Octree& tree_;
  const Labels& labels_;
  std::size_t k_;
  std::uint32_t offset_ = 0;  ///< first point of the leaf less its candidate
  double reach_ = 0, needed_reach_ = 0;
  float error_ = 0;  ///< of a squared distance in single precision
  float guess_ = 0;  ///< squared radius that held about k points in the last search
  std::size_t size_ = 0, padded_ = 0;  ///< candidates, and the same in whole vectors
  std::vector<std::uint32_t> index_;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> leaves_;  ///< end of its candidates, leaf
  std::vector<float> x_, y_, z_, squared_;
  std::vector<float> closed_;  ///< 0 for open candidates, else infinity
  std::vector<double> exact_, sorted_;
  std::vector<double> dx_, dy_, dz_;  ///< offsets of the nearest
  std::vector<std::uint32_t> nearest_;
};

}  // namespace docdepth
