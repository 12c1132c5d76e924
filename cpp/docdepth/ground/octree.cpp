#include "docdepth/ground/octree.hpp"

#include <algorithm>
#include <bit>

namespace docdepth {
namespace {

/// Larger nodes of the octree are split [points].
constexpr std::uint32_t kLeafSize = 128;
constexpr int kLevels = 19;  // bits of a block's coordinate

/// Every third bit of a block's coordinate.
std::uint64_t spread(std::uint64_t x) {
  x = (x | x << 32) & 0x001f00000000ffffu;
  x = (x | x << 16) & 0x001f0000ff0000ffu;
  x = (x | x << 8) & 0x100f00f00f00f00fu;
  x = (x | x << 4) & 0x10c30c30c30c30c3u;
  return (x | x << 2) & 0x1249249249249249u;
}

std::uint64_t morton_code(std::uint64_t key) {
  constexpr std::uint64_t kMask = (std::uint64_t{1} << kLevels) - 1;
  return spread(key >> 2 * kLevels) << 2 | spread(key >> kLevels & kMask) << 1 |
         spread(key & kMask);
}

}  // namespace

Octree::Octree(VoxelMap& map, int threads) {
  sort_blocks(map, threads);
  take_points(threads);
  split(threads);
}

void Octree::sort_blocks(VoxelMap& map, int threads) {
  constexpr std::size_t kShards = VoxelMap::kShards;
  std::size_t ends[kShards + 1] = {};
  for (std::size_t s = 0; s < kShards; ++s) ends[s + 1] = ends[s] + map.shards[s].blocks;
  blocks_.resize(ends[kShards]);
  const auto before = [](const Entry& a, const Entry& b) { return a.code < b.code; };
  parallel_for(kShards, 1, threads, [&](std::size_t s, std::size_t) {
    auto& shard = map.shards[s];
    auto out = blocks_.begin() + ends[s];
    for (VoxelBlock& block : shard.table)
      if (block.occupied) *out++ = {morton_code(block.key), &block, &shard.voxels[block.first]};
    std::sort(blocks_.begin() + ends[s], out, before);
  });
  std::vector<Entry> merged(blocks_.size());
  for (std::size_t width = 1; width < kShards; width *= 2) {
    parallel_for(kShards, 2 * width, threads, [&](std::size_t s, std::size_t) {
      const auto begin = blocks_.begin();
      std::merge(begin + ends[s], begin + ends[s + width], begin + ends[s + width],
                 begin + ends[s + 2 * width], merged.begin() + ends[s], before);
    });
    blocks_.swap(merged);
  }
}

void Octree::take_points(int threads) {
  starts_.resize(blocks_.size() + 1);
  for (std::size_t b = 0; b < blocks_.size(); ++b)
    starts_[b + 1] = starts_[b] + std::popcount(blocks_[b].block->occupied);
  points_.resize(starts_.back());
  parallel_for(blocks_.size(), 4096, threads, [&](std::size_t begin, std::size_t end) {
    for (std::size_t b = begin; b < end; ++b) {
      __builtin_prefetch(blocks_[std::min(b + 8, end - 1)].voxels);
      const Voxel* voxel = blocks_[b].voxels;
      for (std::uint32_t i = starts_[b]; i < starts_[b + 1]; ++i) points_[i] = (voxel++)->mean();
    }
  });
}

/// Make nodes level by level, so that the children of each are consecutive. A node with all its
/// points in one child is that child.
void Octree::split(int threads) {
  struct Range {
    std::uint32_t begin, end;  // blocks
    int level;
  };
  std::vector<Range> ranges{{0, static_cast<std::uint32_t>(blocks_.size()), kLevels}};
  const auto add_node = [&](const Range& range) {
    nodes_.push_back({{}, starts_[range.begin], starts_[range.end], 0, 0});
  };
  if (blocks_.empty()) return;
  add_node(ranges[0]);
  for (std::size_t n = 0; n < nodes_.size(); ++n) {
    auto [begin, end, level] = ranges[n];
    if (nodes_[n].end - nodes_[n].begin <= kLeafSize || end - begin == 1) continue;
    while (blocks_[begin].code >> 3 * (level - 1) == blocks_[end - 1].code >> 3 * (level - 1))
      --level;
    --level;
    nodes_[n].child = static_cast<std::uint32_t>(nodes_.size());
    while (begin < end) {
      const std::uint64_t cell = blocks_[begin].code >> 3 * level;
      const auto next =
          std::partition_point(blocks_.begin() + begin, blocks_.begin() + end,
                               [&](const Entry& entry) { return entry.code >> 3 * level == cell; });
      const auto stop = static_cast<std::uint32_t>(next - blocks_.begin());
      ranges.push_back({begin, stop, level});
      add_node(ranges.back());
      begin = stop;
    }
    nodes_[n].children = static_cast<std::uint32_t>(nodes_.size()) - nodes_[n].child;
  }
  parallel_for(nodes_.size(), 4096, threads, [&](std::size_t first, std::size_t last) {
    for (std::size_t n = first; n < last; ++n)
      if (!nodes_[n].children)
        for (std::uint32_t i = nodes_[n].begin; i < nodes_[n].end; ++i)
          nodes_[n].box.extend(points_[i]);
  });
  for (std::size_t n = nodes_.size(); n-- > 0;)
    for (std::uint32_t c = 0; c < nodes_[n].children; ++c)
      nodes_[n].box.extend(nodes_[nodes_[n].child + c].box);
}

std::uint32_t Octree::leaf_of(std::uint32_t point) const {
  std::uint32_t n = 0;
  while (nodes_[n].children) {
    n = nodes_[n].child;
    while (nodes_[n].end <= point) ++n;
  }
  return n;
}

std::uint32_t Octree::quantile(double x, double y, double radius, double share) const {
  std::vector<std::uint32_t> inside, open;
  if (!nodes_.empty()) open.push_back(0);
  while (!open.empty()) {
    const Node& node = nodes_[open.back()];
    open.pop_back();
    const Eigen::Vector3d nearest =
        Eigen::Vector3d(x, y, 0).cwiseMax(node.box.min()).cwiseMin(node.box.max());
    const double dx = nearest.x() - x, dy = nearest.y() - y;
    if (dx * dx + dy * dy > radius * radius) continue;
    for (std::uint32_t c = 0; c < node.children; ++c) open.push_back(node.child + c);
    for (std::uint32_t i = node.begin; !node.children && i < node.end; ++i) {
      const double px = points_[i].x() - x, py = points_[i].y() - y;
      if (px * px + py * py <= radius * radius) inside.push_back(i);
    }
  }
  if (inside.empty()) return static_cast<std::uint32_t>(points_.size());
  const auto chosen = inside.begin() + std::ptrdiff_t(share * double(inside.size() - 1));
  std::nth_element(inside.begin(), chosen, inside.end(), [&](std::uint32_t a, std::uint32_t b) {
    return nearer(points_[a].z(), points_[a], points_[b].z(), points_[b]);
  });
  return *chosen;
}

}  // namespace docdepth
