#include "docdepth/objects/detections.hpp"

#include "docdepth/geometry/rigid.hpp"
#include "docdepth/objects/constants.hpp"

namespace docdepth {
namespace {

/// Samples of samples where downsample(points, size, most) would start from the points again: much
/// faster, and as even.
SampledPoints sample(const SampledPoints& points, const Extent& box) {
  if (box.width() > kMaxObjectWidth) return downsample(points, kWideSampleSpacing);
  float size = kSampleSpacing;
  SampledPoints samples = downsample(points, size);
  while (samples.size() > kMaxSamples) samples = downsample(samples, size *= kSampleSpacingGrowth);
  return samples;
}

}  // namespace

Detections detect_objects(const Points& points, const bool* ground, const std::uint32_t* objects,
                          const bool* dynamic, const Pose& T_world_lidar) {
  const auto count = static_cast<std::uint32_t>(points.rows());
  constexpr std::uint32_t kUnseen = 0xffffffff;
  std::vector<std::uint32_t> size(count, 0), number(count, kUnseen);
  for (std::uint32_t i = 0; i < count; ++i)
    if (!ground[i]) ++size[objects[i]];
  Detections detections;
  std::vector<SampledPoints> members;
  const RigidTransform T(T_world_lidar);
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::uint32_t first = objects[i];
    if (ground[i] || size[first] < kMinDetectionPoints) continue;
    const Eigen::Vector3f p = T * Eigen::Vector3f(points(i, 0), points(i, 1), points(i, 2));
    if (number[first] == kUnseen) {
      number[first] = static_cast<std::uint32_t>(detections.size());
      detections.push_back({first, 0, 0, {p, p}, {}});
      members.emplace_back().reserve(size[first]);
    }
    Detection& object = detections[number[first]];
    ++object.points;
    object.dynamic += dynamic[i];
    object.box.add({p, p});
    members[number[first]].push_back(p);
  }
  for (std::size_t k = 0; k < detections.size(); ++k)
    detections[k].samples = sample(members[k], detections[k].box);
  return detections;
}

}  // namespace docdepth
