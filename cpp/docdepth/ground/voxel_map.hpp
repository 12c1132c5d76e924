// Sweeps merged into voxels.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// The sum of the points of a voxel, in the order in which they came.
struct Voxel {
  Eigen::Vector3d sum;
  double count;

  Eigen::Vector3d mean() const { return sum / count; }
};

/// 4 x 4 x 4 voxels. Neighbouring returns fall into the same block, which is then in the cache, and
/// 32 bytes tell for 64 voxels what is occupied and what is ground.
struct VoxelBlock {
  std::uint64_t key = 0;       ///< packed coordinates of the block
  std::uint64_t occupied = 0;  ///< one bit per voxel; 0: a free slot of the table
  std::uint64_t ground = 0;    ///< one bit per voxel
  std::uint32_t first = 0;     ///< its first voxel; they follow in the order of their bits
  std::uint32_t capacity = 0;
};

/// The points that a thread takes at once, relative to the origin, the blocks that hold them, and
/// the bits of their voxels within these.
struct Addressed {
  static constexpr std::size_t kMost = 2048;

  double x[kMost], y[kMost], z[kMost];
  std::uint64_t key[kMost];
  std::uint32_t shard[kMost], bit[kMost];

  Eigen::Vector3d point(std::size_t i) const { return {x[i], y[i], z[i]}; }
};

/// Takes points to world coordinates relative to an origin, in double precision and in the order of
/// operations of RigidTransform, and finds their voxels.
class VoxelGrid {
 public:
  VoxelGrid(const Pose& T_world_lidar, const Eigen::Vector3d& origin, double voxel_size);

  /// Up to Addressed::kMost points.
  /// @throws std::out_of_range a point is not finite or too far from the origin
  void find(const float* points, std::size_t count, Addressed& found) const;

 private:
  double r_[3][3];
  double t_[3];
  double voxel_size_;
};

/// A hash table of blocks in shards. One thread fills a shard in the order of the points, so the
/// sums do not depend on the number of threads.
class VoxelMap {
 public:
  static constexpr std::size_t kShards = 16;

  void insert(const Points& points, const VoxelGrid& grid, int threads);
  void label(const Points& points, const VoxelGrid& grid, int threads, bool* ground) const;

  /// Number of voxels.
  std::size_t size() const;

  struct Shard {
    std::vector<VoxelBlock> table;  ///< open addressing, a power of two of slots
    std::size_t blocks = 0;
    std::size_t size = 0;
    std::vector<Voxel> voxels;
    std::array<std::vector<std::uint32_t>, 65> unused;  ///< free ranges of voxels, by capacity

    const VoxelBlock* find(std::uint64_t key) const;
    /// Prefetch the slot where find() and add() start.
    void fetch(std::uint64_t key) const;
    void add(std::uint64_t key, std::uint32_t bit, const Eigen::Vector3d& p);

   private:
    VoxelBlock& find_or_make(std::uint64_t key);
    void widen(VoxelBlock& block, std::uint32_t used);
    void rehash();
  };
  std::array<Shard, kShards> shards;

 private:
  struct Inserted {
    Eigen::Vector3d point;
    std::uint64_t voxel;  ///< its block's 57 bits, and 6 within it
  };
  std::vector<Inserted> sorted_;  // the points of a sweep by shards; kept to be used again
};

}  // namespace docdepth
