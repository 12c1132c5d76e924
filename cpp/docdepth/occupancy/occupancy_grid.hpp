// Voxels around the vehicle: free, occupied, or not observed.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <vector>

#include "docdepth/geometry/types.hpp"
#include "docdepth/occupancy/sweep_rays.hpp"

namespace docdepth {

/// The defaults are those of Occ3D-nuScenes.
struct OccupancyOptions {
  double voxel = 0.4;                     ///< edge [m]
  std::array<int, 3> size{200, 200, 16};  ///< voxels along x, y, z
  Eigen::Vector3d corner{-40, -40, -1};   ///< lowest corner of the grid [m]
  /// A voxel is occupied if at least this share of the rays that reach it end there. Rays that
  /// graze the ground pass a dozen of its voxels before they end.
  double min_share = 0.005;
};

enum class Occupied : std::uint8_t { kNot, kStatic, kGround, kObject };

struct OccupiedVoxels {
  std::vector<Occupied> occupied;
  std::vector<std::uint16_t> object;   ///< 0 for none
  std::vector<std::uint8_t> observed;  ///< free or occupied
};

/// A pinhole camera in the grid.
struct GridCamera {
  Eigen::Matrix3d K;
  int width, height;
  Pose T_grid_camera;
};

/// Counts rays that end in a voxel and rays that pass it.
///
/// A voxel inside the box of an object is passed only by rays that the object's motion carries to
/// its time: those of another time crossed the place before the object came. So what no ray passed
/// inside of a box stays unobserved. Voxels are numbered row by row, z last.
class OccupancyGrid {
 public:
  explicit OccupancyGrid(const OccupancyOptions& options = {});

  /// Place an object, before rays are added.
  /// @param number  from 1 on
  /// @param T_grid_object  x forward, z up, the origin in the centre of the bottom of the box
  void add_object(std::uint16_t number, const Pose& T_grid_object, const Eigen::Vector3d& size);

  /// Count what stands by the rays of a sweep.
  /// @param unfollowed  object of the sweep that has no track, and moves just there; 0 for none
  void add_sweep(const std::vector<Ray>& rays, const Pose& T_grid_lidar,
                 std::uint16_t unfollowed = 0);

  /// Count an object by the rays of a sweep that come near to it.
  /// @param of_sweep  its number among the objects of the sweep; 0 if none of them is it
  /// @param T_grid_lidar  where the LiDAR was about the object, which is where it is in the grid
  /// @param velocity  of the object at the stamp, LiDAR frame [m/s]
  void add_sweep_of_object(std::uint16_t number, std::uint16_t of_sweep,
                           const std::vector<Ray>& rays, const Pose& T_grid_lidar,
                           const Eigen::Vector3f& velocity);

  OccupiedVoxels classify() const;

  /// Which observed voxels a camera sees: on a line to the middle of one, those up to the first
  /// that is occupied. So it sees the road, of which each voxel hides the middle of the next.
  std::vector<std::uint8_t> seen_by(const std::vector<GridCamera>& cameras,
                                    const OccupiedVoxels& voxels) const;

  const OccupancyOptions& options() const { return options_; }

 private:
  static constexpr std::size_t kOutside = ~std::size_t{0};

  struct Box {
    Pose T_box_grid;  ///< the origin in the middle of the box
    Eigen::Vector3d half;
  };

  Eigen::Vector3d in_voxels(const Eigen::Vector3d& p) const;
  std::size_t voxel_of(const Eigen::Vector3d& in_voxels) const;

  OccupancyOptions options_;
  std::vector<std::uint32_t> passes_, static_hits_, ground_hits_, object_hits_;
  std::vector<std::uint32_t> passes_of_object_;  ///< of the object in whose box a voxel lies
  std::vector<std::uint16_t> box_;               ///< number of that object, 0 for none
  std::vector<std::uint16_t> object_;            ///< that last hit a voxel
  std::map<std::uint16_t, Box> boxes_;
};

}  // namespace docdepth
