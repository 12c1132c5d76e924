#include "docdepth/objects/dynamic_voxels.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/objects/constants.hpp"

namespace docdepth {
namespace {

struct SampleCount {
  int dynamic = 0, fixed = 0;
};

std::vector<std::uint64_t> voxels_of_sweep(std::size_t sweep,
                                           const std::vector<const Detections*>& detections,
                                           const std::vector<double>& times,
                                           const std::vector<TrackedSweep>& tracked,
                                           double window) {
  std::unordered_map<std::uint64_t, SampleCount> counts;
  for (const bool dynamic : {true, false})
    for (std::size_t i = 0; i < times.size(); ++i) {
      if (i == sweep || std::fabs(times[i] - times[sweep]) > window + kTimeTolerance) continue;
      for (const Detection& object : *detections[i]) {
        if ((object.is_dynamic() || tracked[i].claims(object.first)) != dynamic) continue;
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

}  // namespace

std::uint64_t voxel_of(const Eigen::Vector3f& point) {
  return voxel_key(voxel_coordinate(point.x(), kDynamicVoxelSize),
                   voxel_coordinate(point.y(), kDynamicVoxelSize),
                   voxel_coordinate(point.z(), kDynamicVoxelSize));
}

std::vector<std::vector<std::uint64_t>> dynamic_voxels(
    const std::vector<const Detections*>& detections, const std::vector<double>& times,
    const std::vector<TrackedSweep>& tracked, double window, int threads) {
  std::vector<std::vector<std::uint64_t>> result(detections.size());
  if (!(window > 0)) return result;
  parallel_for(detections.size(), 1, threads, [&](std::size_t i, std::size_t) {
    result[i] = voxels_of_sweep(i, detections, times, tracked, window);
  });
  return result;
}

}  // namespace docdepth
