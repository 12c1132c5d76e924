#include "docdepth/evidence/points_inside.hpp"

#include <algorithm>
#include <utility>

#include "docdepth/evidence/dynamic_voxels.hpp"
#include "docdepth/geometry/rigid.hpp"

namespace docdepth {

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
