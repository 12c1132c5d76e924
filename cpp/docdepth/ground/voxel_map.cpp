#include "docdepth/ground/voxel_map.hpp"

#include <algorithm>
#include <bit>
#include <stdexcept>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/simd.hpp"

namespace docdepth {
namespace {

/// Voxels on either side of the origin of a map: 2^20, which is 31 km at 3 cm.
constexpr std::int64_t kMapReach = std::int64_t{1} << 20;
/// Points whose hash slots are fetched ahead of use.
constexpr std::size_t kPrefetchAhead = 8;
constexpr double kLast = kMapReach - 0x1p-33;  // the last number below kMapReach

DOCDEPTH_KERNEL std::uint64_t hash(std::uint64_t key) {
  key *= 0x9e3779b97f4a7c15u;
  return key ^ (key >> 32);
}

/// The next capacity of a block.
std::uint32_t wider(std::uint32_t capacity) {
  static constexpr std::uint32_t kCapacities[] = {1, 2, 4, 6, 8, 12, 16, 24, 32, 48, 64};
  return *std::upper_bound(std::begin(kCapacities), std::end(kCapacities), capacity);
}

int rank(const VoxelBlock& block, std::uint32_t bit) {
  return std::popcount(block.occupied & ((std::uint64_t{1} << bit) - 1));
}

struct FindVoxels {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* points, const double (*r)[3],
                                  const double* t, double voxel_size, Addressed* __restrict found,
                                  bool* far) {
    int outside = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const double x = points[3 * i], y = points[3 * i + 1], z = points[3 * i + 2];
      const double p[3] = {((r[0][0] * x + r[0][1] * y) + r[0][2] * z) + t[0],
                           ((r[1][0] * x + r[1][1] * y) + r[1][2] * z) + t[1],
                           ((r[2][0] * x + r[2][1] * y) + r[2][2] * z) + t[2]};
      std::uint64_t key = 0, bit = 0;
      for (int axis = 0; axis < 3; ++axis) {
        const double voxel = p[axis] / voxel_size;
        double cell = voxel > -kMapReach ? voxel : -kMapReach;  // also for NaN
        cell = cell < kLast ? cell : kLast;
        outside |= cell == voxel ? 0 : 1;
        const auto whole = static_cast<std::int32_t>(cell);
        const std::int32_t below = static_cast<double>(whole) > cell ? 1 : 0;
        const auto index = static_cast<std::uint64_t>(whole + (std::int32_t{kMapReach} - below));
        key = key << 19 | index >> 2;
        bit = bit << 2 | (index & 3);
      }
      found->x[i] = p[0];
      found->y[i] = p[1];
      found->z[i] = p[2];
      found->key[i] = key;
      found->bit[i] = static_cast<std::uint32_t>(bit);
      found->shard[i] = static_cast<std::uint32_t>(hash(key) >> 60);
    }
    *far = outside;
  }
};

}  // namespace

VoxelGrid::VoxelGrid(const Pose& T, const Eigen::Vector3d& origin, double voxel_size)
    : voxel_size_(voxel_size) {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) r_[i][j] = T.linear()(i, j);
    t_[i] = T.translation()(i) - origin[i];
  }
}

void VoxelGrid::find(const float* points, std::size_t count, Addressed& found) const {
  bool far;
  dispatch<FindVoxels>(count, points, r_, t_, voxel_size_, &found, &far);
  if (far) throw std::out_of_range("a point is not finite or too far from the first pose");
}

const VoxelBlock* VoxelMap::Shard::find(std::uint64_t key) const {
  if (table.empty()) return nullptr;
  const std::size_t mask = table.size() - 1;
  for (std::size_t slot = hash(key) & mask;; slot = (slot + 1) & mask) {
    const VoxelBlock& block = table[slot];
    if (!block.occupied) return nullptr;
    if (block.key == key) return &block;
  }
}

VoxelBlock& VoxelMap::Shard::find_or_make(std::uint64_t key) {
  if (3 * (blocks + 1) > 2 * table.size()) rehash();
  const std::size_t mask = table.size() - 1;
  std::size_t slot = hash(key) & mask;
  while (table[slot].occupied && table[slot].key != key) slot = (slot + 1) & mask;
  if (!table[slot].occupied) {
    table[slot].key = key;
    ++blocks;
  }
  return table[slot];
}

void VoxelMap::Shard::rehash() {
  std::vector<VoxelBlock> old(std::max<std::size_t>(64, 2 * table.size()));
  old.swap(table);
  const std::size_t mask = table.size() - 1;
  for (const VoxelBlock& block : old) {
    if (!block.occupied) continue;
    std::size_t slot = hash(block.key) & mask;
    while (table[slot].occupied) slot = (slot + 1) & mask;
    table[slot] = block;
  }
}

void VoxelMap::Shard::widen(VoxelBlock& block, std::uint32_t used) {
  const std::uint32_t capacity = wider(block.capacity);
  std::uint32_t first;
  if (unused[capacity].empty()) {
    first = static_cast<std::uint32_t>(voxels.size());
    voxels.resize(voxels.size() + capacity);
  } else {
    first = unused[capacity].back();
    unused[capacity].pop_back();
  }
  std::copy_n(voxels.begin() + block.first, used, voxels.begin() + first);
  if (block.capacity) unused[block.capacity].push_back(block.first);
  block.first = first;
  block.capacity = capacity;
}

void VoxelMap::Shard::fetch(std::uint64_t key) const {
  if (!table.empty()) __builtin_prefetch(&table[hash(key) & (table.size() - 1)]);
}

void VoxelMap::Shard::add(std::uint64_t key, std::uint32_t bit, const Eigen::Vector3d& p) {
  VoxelBlock& block = find_or_make(key);
  const int place = rank(block, bit);
  const std::uint64_t mask = std::uint64_t{1} << bit;
  if (block.occupied & mask) {
    Voxel& voxel = voxels[block.first + place];
    voxel.sum += p;
    voxel.count += 1.0;
    return;
  }
  const auto used = static_cast<std::uint32_t>(std::popcount(block.occupied));
  if (used == block.capacity) widen(block, used);
  const auto begin = voxels.begin() + block.first;
  std::copy_backward(begin + place, begin + used, begin + used + 1);
  begin[place] = {p, 1.0};
  block.occupied |= mask;
  ++size;
}

void VoxelMap::insert(const Points& points, const VoxelGrid& grid, int threads) {
  const auto count = static_cast<std::size_t>(points.rows());
  const std::size_t parts = (count + Addressed::kMost - 1) / Addressed::kMost;
  sorted_.resize(count);
  // Each block of points is sorted by shard and keeps its order within a shard.
  std::vector<std::array<std::uint32_t, kShards + 1>> starts(parts);
  parallel_for(count, Addressed::kMost, threads, [&](std::size_t begin, std::size_t end) {
    Addressed found;
    grid.find(points.data() + 3 * begin, end - begin, found);
    auto& start = starts[begin / Addressed::kMost];
    start.fill(0);
    for (std::size_t i = 0; i < end - begin; ++i) ++start[found.shard[i] + 1];
    start[0] = static_cast<std::uint32_t>(begin);
    for (std::size_t s = 0; s < kShards; ++s) start[s + 1] += start[s];
    auto next = start;
    for (std::size_t i = 0; i < end - begin; ++i)
      sorted_[next[found.shard[i]]++] = {found.point(i), found.key[i] << 6 | found.bit[i]};
  });
  parallel_for(kShards, 1, threads, [&](std::size_t s, std::size_t) {
    Shard& shard = shards[s];
    for (const auto& start : starts)
      for (std::uint32_t k = start[s]; k < start[s + 1]; ++k) {
        if (k + kPrefetchAhead < start[s + 1]) shard.fetch(sorted_[k + kPrefetchAhead].voxel >> 6);
        const Inserted& inserted = sorted_[k];
        shard.add(inserted.voxel >> 6, inserted.voxel & 63, inserted.point);
      }
  });
}

void VoxelMap::label(const Points& points, const VoxelGrid& grid, int threads, bool* ground) const {
  parallel_for(points.rows(), Addressed::kMost, threads, [&](std::size_t begin, std::size_t end) {
    Addressed found;
    grid.find(points.data() + 3 * begin, end - begin, found);
    for (std::size_t i = 0; i < end - begin; ++i) {
      if (i + kPrefetchAhead < end - begin)
        shards[found.shard[i + kPrefetchAhead]].fetch(found.key[i + kPrefetchAhead]);
      const VoxelBlock* block = shards[found.shard[i]].find(found.key[i]);
      ground[begin + i] = block && (block->ground >> found.bit[i] & 1);
    }
  });
}

std::size_t VoxelMap::size() const {
  std::size_t size = 0;
  for (const Shard& shard : shards) size += shard.size;
  return size;
}

}  // namespace docdepth
