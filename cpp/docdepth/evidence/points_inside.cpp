#include "docdepth/evidence/points_inside.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>
#include <utility>

#include "docdepth/geometry/rigid.hpp"
#include "docdepth/tracking/constants.hpp"

namespace docdepth {
namespace {

/// Edge of a voxel [m].
constexpr float kDynamicVoxelSize = 1.0f;
/// A dynamic voxel has at least this many dynamic samples,
constexpr int kMinDynamicSamples = 3;
/// and they are more than this share of its samples.
constexpr float kMinDynamicSampleShare = 0.6f;

/// Key of the voxel that holds a point.
std::uint64_t voxel_of(const Eigen::Vector3f& point) {
  return voxel_key(point, kDynamicVoxelSize);
}

struct SampleCount {
  int dynamic = 0, fixed = 0;
};

}  // namespace

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

void add_points_inside(const Points& points, const bool* ground, const std::uint16_t* static_votes,
                       const std::uint16_t* dynamic_votes, const Pose& T_world_lidar,
                       const std::vector<OrientedBox>& boxes,
                       const std::vector<std::uint64_t>& voxels, std::vector<std::uint8_t>& dynamic,
                       const ClassificationOptions& options) {
  const RigidTransform T(T_world_lidar);
  std::vector<std::pair<Eigen::Vector3f, float>> spheres;  // around the boxes; far faster to test
  for (const OrientedBox& box : boxes)
    spheres.emplace_back(box.middle(), box.half.norm() + 2 * kObjectMargin);
  for (std::size_t i = 0; i < dynamic.size(); ++i) {
    if (dynamic[i] || ground[i] || static_votes[i] > dynamic_votes[i] + options.isolated_votes)
      continue;
    const Eigen::Vector3f at = T * Eigen::Vector3f(points(i, 0), points(i, 1), points(i, 2));
    bool inside = std::binary_search(voxels.begin(), voxels.end(), voxel_of(at));
    for (std::size_t k = 0; k < boxes.size() && !inside; ++k)
      inside = (at - spheres[k].first).squaredNorm() <= spheres[k].second * spheres[k].second &&
               boxes[k].contains(at, kObjectMargin);
    dynamic[i] = inside;
  }
}

}  // namespace docdepth
