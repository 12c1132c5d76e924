// The points of the voxels along a Morton curve, and the octree that this order makes.
//
// Why not nanoflann, which answers one query after the other in 1 to 3 microseconds: the front of
// ground growing asks for the neighbours of all points of a region. A leaf gathers once what is
// near all of its points. On the 12.3 million points of KITTI raw drive 0005, labels equalled those
// of a version with nanoflann.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/ground/voxel_map.hpp"

namespace docdepth {

class Octree {
 public:
  struct Node {
    Eigen::AlignedBox3d box;        ///< of its points
    std::uint32_t begin, end;       ///< its points
    std::uint32_t child, children;  ///< its nodes; none in a leaf
  };

  /// @param map  must outlive the tree unchanged
  Octree(VoxelMap& map, int threads);

  /// Centroids of the voxels. The points of a node are consecutive.
  const std::vector<Eigen::Vector3d>& points() const { return points_; }
  /// The first one is the root.
  const std::vector<Node>& nodes() const { return nodes_; }
  /// Index of the leaf that holds a point.
  std::uint32_t leaf_of(std::uint32_t point) const;
  /// Of the points within `radius` of (x, y), the one with this share of the others below it; of
  /// equal heights the smallest x, then y. The number of all points if there is none.
  std::uint32_t quantile(double x, double y, double radius, double share) const;

  /// Call visit(leaf) for each leaf whose box meets `box`, in the order of the points.
  template <class Visit>
  void visit_leaves(const Eigen::AlignedBox3d& box, const Visit& visit) const {
    visit_leaves(0, box, visit);
  }

  /// Write is_ground(point) into the blocks of the map.
  template <class IsGround>
  void store_ground(const IsGround& is_ground, int threads) const {
    parallel_for(blocks_.size(), 4096, threads, [&](std::size_t begin, std::size_t end) {
      for (std::size_t b = begin; b < end; ++b) {
        std::uint64_t ground = 0, rest = blocks_[b].block->occupied;
        for (std::uint32_t i = starts_[b]; i < starts_[b + 1]; ++i, rest &= rest - 1)
          if (is_ground(i)) ground |= rest & (~rest + 1);
        blocks_[b].block->ground = ground;
      }
    });
  }

 private:
  struct Entry {
    std::uint64_t code;
    VoxelBlock* block;
    const Voxel* voxels;
  };

  template <class Visit>
  void visit_leaves(std::uint32_t index, const Eigen::AlignedBox3d& box, const Visit& visit) const {
    const Node& node = nodes_[index];
    if (!box.intersects(node.box)) return;
    if (!node.children) return visit(index);
    for (std::uint32_t c = 0; c < node.children; ++c) visit_leaves(node.child + c, box, visit);
  }

  void sort_blocks(VoxelMap& map, int threads);
  void take_points(int threads);
  void split(int threads);

  std::vector<Entry> blocks_;          ///< in the order of their Morton codes
  std::vector<std::uint32_t> starts_;  ///< first point of each block, and the end
  std::vector<Eigen::Vector3d> points_;
  std::vector<Node> nodes_;
};

/// Whether a comes before b among points at these distances: equal ones are settled by coordinates.
inline bool nearer(double distance_a, const Eigen::Vector3d& a, double distance_b,
                   const Eigen::Vector3d& b) {
  if (distance_a != distance_b) return distance_a < distance_b;
  for (int i = 0; i < 2; ++i)
    if (a[i] != b[i]) return a[i] < b[i];
  return a[2] < b[2];
}

}  // namespace docdepth
