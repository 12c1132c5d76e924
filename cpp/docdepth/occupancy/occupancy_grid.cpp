#include "docdepth/occupancy/occupancy_grid.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "docdepth/occupancy/traversal.hpp"

namespace docdepth {
namespace {

/// Where a way leads through a box about the origin: shares of it; empty if the first is larger.
std::pair<double, double> inside(const Eigen::Vector3d& from, const Eigen::Vector3d& way,
                                 const Eigen::Vector3d& half) {
  double begin = 0, end = 1;
  for (int axis = 0; axis < 3; ++axis) {
    const double low = (-half(axis) - from(axis)) / way(axis);
    const double high = (half(axis) - from(axis)) / way(axis);
    begin = std::max(begin, std::min(low, high)), end = std::min(end, std::max(low, high));
  }
  return {begin, end};
}

}  // namespace

OccupancyGrid::OccupancyGrid(const OccupancyOptions& options) : options_(options) {
  const auto& size = options.size;
  if (!(options.voxel > 0) || std::min({size[0], size[1], size[2]}) < 1)
    throw std::invalid_argument("a grid needs voxels");
  const auto voxels = std::size_t(size[0]) * std::size_t(size[1]) * std::size_t(size[2]);
  for (auto* counts : {&passes_, &static_hits_, &ground_hits_, &object_hits_, &passes_of_object_})
    counts->resize(voxels);
  box_.resize(voxels), object_.resize(voxels);
}

Eigen::Vector3d OccupancyGrid::in_voxels(const Eigen::Vector3d& p) const {
  return (p - options_.corner) / options_.voxel;
}

std::size_t OccupancyGrid::voxel_of(const Eigen::Vector3d& in_voxels) const {
  std::size_t voxel = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const double cell = std::floor(in_voxels(axis));
    if (!(cell >= 0 && cell < options_.size[axis])) return kOutside;
    voxel = voxel * std::size_t(options_.size[axis]) + std::size_t(cell);
  }
  return voxel;
}

void OccupancyGrid::add_object(std::uint16_t number, const Pose& T_grid_object,
                               const Eigen::Vector3d& size) {
  Box box{T_grid_object.inverse(Eigen::Isometry), size / 2};
  box.T_box_grid.translation().z() -= box.half.z();
  boxes_[number] = box;
  const Eigen::Vector3d middle = in_voxels(T_grid_object * Eigen::Vector3d(0, 0, box.half.z()));
  const double reach = box.half.norm() / options_.voxel;
  std::array<int, 3> low, high;
  for (int axis = 0; axis < 3; ++axis) {
    const double most = options_.size[axis];
    low[axis] = static_cast<int>(std::clamp(std::floor(middle(axis) - reach), 0.0, most));
    high[axis] = static_cast<int>(std::clamp(std::ceil(middle(axis) + reach), 0.0, most));
  }
  for (int x = low[0]; x < high[0]; ++x)
    for (int y = low[1]; y < high[1]; ++y)
      for (int z = low[2]; z < high[2]; ++z) {
        const Eigen::Vector3d at =
            options_.corner + options_.voxel * Eigen::Vector3d(x + 0.5, y + 0.5, z + 0.5);
        const Eigen::Vector3d local = box.T_box_grid * at;
        if ((local.cwiseAbs().array() <= box.half.array()).all())
          box_[voxel_of(Eigen::Vector3d(x, y, z))] = number;
      }
}

void OccupancyGrid::add_sweep(const std::vector<Ray>& rays, const Pose& T_grid_lidar,
                              std::uint16_t unfollowed) {
  for (const Ray& ray : rays) {
    const Eigen::Vector3d from = in_voxels(T_grid_lidar * ray.origin.cast<double>());
    const Eigen::Vector3d to = in_voxels(T_grid_lidar * ray.end.cast<double>());
    const std::size_t end = voxel_of(to);
    traverse(from, to, options_.size, [&](std::size_t voxel) {
      passes_[voxel] += ray.count;
      return true;
    });
    if (end == kOutside) continue;
    passes_[end] -= ray.count;
    if (ray.object == 0)
      (ray.ground ? ground_hits_ : static_hits_)[end] += ray.count;
    else if (ray.object == unfollowed)
      object_hits_[end] += ray.count;
  }
}

void OccupancyGrid::add_sweep_of_object(std::uint16_t number, std::uint16_t of_sweep,
                                        const std::vector<Ray>& rays, const Pose& T_grid_lidar,
                                        const Eigen::Vector3f& velocity) {
  const Box& box = boxes_.at(number);
  // Voxels whose centre lies in the box reach out of it.
  const Eigen::Vector3d half = box.half.array() + 0.87 * options_.voxel;
  const Pose T_box_lidar = box.T_box_grid * T_grid_lidar;
  for (const Ray& ray : rays) {
    const Eigen::Vector3d shift = (-ray.seconds * velocity).cast<double>();
    const Eigen::Vector3d origin = ray.origin.cast<double>() + shift;
    const Eigen::Vector3d end = ray.end.cast<double>() + shift;
    const Eigen::Vector3d way = T_box_lidar.linear() * (end - origin);
    const auto [first, last] = inside(T_box_lidar * origin, way, half);
    const bool is_own = of_sweep && ray.object == of_sweep;
    if (!(first < last) && !is_own) continue;
    const Eigen::Vector3d from = in_voxels(T_grid_lidar * origin);
    const Eigen::Vector3d to = in_voxels(T_grid_lidar * end);
    const std::size_t end_voxel = voxel_of(to);
    if (first < last)
      traverse(from + first * (to - from), from + last * (to - from), options_.size,
               [&](std::size_t voxel) {
                 if (voxel != end_voxel && box_[voxel] == number)
                   passes_of_object_[voxel] += ray.count;
                 return true;
               });
    if (is_own && end_voxel != kOutside) {
      object_hits_[end_voxel] += ray.count;
      object_[end_voxel] = number;
    }
  }
}

OccupiedVoxels OccupancyGrid::classify() const {
  OccupiedVoxels found;
  for (std::size_t i = 0; i < passes_.size(); ++i) {
    const std::uint32_t hits = static_hits_[i] + ground_hits_[i];
    const std::uint32_t passes = box_[i] ? passes_of_object_[i] : passes_[i];
    Occupied what = Occupied::kNot;
    if (object_hits_[i])
      what = Occupied::kObject;
    else if (hits > 0 && double(hits) >= options_.min_share * double(hits + passes_[i]))
      what = ground_hits_[i] >= static_hits_[i] ? Occupied::kGround : Occupied::kStatic;
    found.occupied.push_back(what);
    found.object.push_back(object_[i]);
    found.observed.push_back(what != Occupied::kNot || passes > 0);
  }
  return found;
}

std::vector<std::uint8_t> OccupancyGrid::seen_by(const std::vector<GridCamera>& cameras,
                                                 const OccupiedVoxels& voxels) const {
  std::vector<std::uint8_t> seen(passes_.size());
  const auto& size = options_.size;
  for (const GridCamera& camera : cameras) {
    const Pose T_camera_grid = camera.T_grid_camera.inverse(Eigen::Isometry);
    const Eigen::Vector3d centre = in_voxels(camera.T_grid_camera.translation());
    std::size_t voxel = 0;
    for (int x = 0; x < size[0]; ++x)
      for (int y = 0; y < size[1]; ++y)
        for (int z = 0; z < size[2]; ++z, ++voxel) {
          if (!voxels.observed[voxel]) continue;
          const Eigen::Vector3d middle(x + 0.5, y + 0.5, z + 0.5);
          const Eigen::Vector3d at = T_camera_grid * (options_.corner + options_.voxel * middle);
          const Eigen::Vector3d pixel = camera.K * at;
          if (!(at.z() > 0 && pixel.x() >= -0.5 * at.z() && pixel.y() >= -0.5 * at.z() &&
                pixel.x() < (camera.width - 0.5) * at.z() &&
                pixel.y() < (camera.height - 0.5) * at.z()))
            continue;
          traverse(centre, middle, size, [&](std::size_t on_the_way) {
            seen[on_the_way] |= voxels.observed[on_the_way];
            return voxels.occupied[on_the_way] == Occupied::kNot;
          });
        }
  }
  return seen;
}

}  // namespace docdepth
