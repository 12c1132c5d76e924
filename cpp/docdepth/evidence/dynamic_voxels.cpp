#include "docdepth/evidence/dynamic_voxels.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "docdepth/tracking/constants.hpp"

namespace docdepth {
namespace {

/// Edge of a voxel [m].
constexpr float kDynamicVoxelSize = 1.0f;
/// A dynamic voxel has at least this many dynamic samples,
constexpr int kMinDynamicSamples = 3;
/// and they are more than this share of its samples.
constexpr float kMinDynamicSampleShare = 0.6f;

struct SampleCount {
  int dynamic = 0, fixed = 0;
};

}  // namespace

std::uint64_t voxel_of(const Eigen::Vector3f& point) {
  return voxel_key(voxel_coordinate(point.x(), kDynamicVoxelSize),
                   voxel_coordinate(point.y(), kDynamicVoxelSize),
                   voxel_coordinate(point.z(), kDynamicVoxelSize));
}

std::vector<std::uint64_t> dynamic_voxels(
    std::size_t sweep, std::size_t first,
    const std::vector<std::shared_ptr<const Detections>>& around, const std::vector<double>& times,
    const std::vector<TrackedSweep>& tracked, double window) {
  if (!(window > 0)) return {};
  std::unordered_map<std::uint64_t, SampleCount> counts;
  for (const bool dynamic : {true, false})
    for (std::size_t i = first; i < first + around.size(); ++i) {
      if (i == sweep || std::fabs(times[i] - times[sweep]) > window + kTimeTolerance) continue;
      for (const Detection& object : *around[i - first]) {
        if ((object.is_dynamic() || tracked[i].makes_dynamic(object.first)) != dynamic) continue;
        for (const Eigen::Vector3f& sample : object.samples()) {
          if (dynamic) {
            ++counts[voxel_of(sample)].dynamic;
          } else if (const auto found = counts.find(voxel_of(sample)); found != counts.end()) {
            ++found->second.fixed;
          }
        }
      }
    }
  std::vector<std::uint64_t> voxels;
  for (const auto& [voxel, count] : counts)
    if (count.dynamic >= kMinDynamicSamples &&
        float(count.dynamic) > kMinDynamicSampleShare * float(count.dynamic + count.fixed))
      voxels.push_back(voxel);
  std::sort(voxels.begin(), voxels.end());
  return voxels;
}

}  // namespace docdepth
