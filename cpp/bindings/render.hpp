// Arguments of the renderers.
#pragma once

#include <pybind11/stl.h>

#include <tuple>

#include "arrays.hpp"
#include "docdepth/render/camera.hpp"
#include "docdepth/render/cloud.hpp"
#include "docdepth/render/mesh_frame.hpp"
#include "docdepth/render/splats.hpp"

namespace docdepth::bindings {

inline Camera as_camera(const Array<double>& K, int width, int height) {
  if (K.ndim() != 2 || K.shape(0) != 3 || K.shape(1) != 3)
    throw std::invalid_argument("K must be a float64 array of shape (3, 3)");
  in_range(width, 1, kMaxSide, "width");
  in_range(height, 1, kMaxSide, "height");
  in_range(std::int64_t{width} * height, 1, kMaxPixels, "width times height");
  for (const int axis : {0, 1}) {
    in_range(K.at(axis, axis), 1 / kMaxFocalLength, kMaxFocalLength, "a focal length in pixels");
    in_range(K.at(axis, 2), -kMaxFocalLength, kMaxFocalLength, "a principal point in pixels");
  }
  return {K.at(0, 0), K.at(1, 1), K.at(0, 2), K.at(1, 2), width, height};
}

using Placed = std::pair<const Frame*, Array<double>>;
using Size = std::pair<double, double>;  // sigma_max, sigma_min

inline SplatSize as_size(const Size& size) {
  return {in_range(size.first, 0, kMaxSplat, "sigma_max"),
          in_range(size.second, 0, kMaxSplat, "sigma_min")};
}

template <class Any>
const Any& present(const Any* frame) {
  if (!frame) throw std::invalid_argument("a frame is None");
  return *frame;
}

/// The static and the dynamic points of frames, with the sizes of their splats.
struct PlacedClouds {
  SplatHeights static_heights, dynamic_heights;
  std::vector<PlacedCloud> clouds;

  PlacedClouds(const std::vector<Placed>& static_frames, const std::vector<Placed>& dynamic_frames,
               const Size& static_size, const Size& dynamic_size)
      : static_heights(as_size(static_size)), dynamic_heights(as_size(dynamic_size)) {
    int sweep = 0;
    for (const auto& [frame, pose] : static_frames)
      clouds.push_back({&present(frame).static_points, as_pose(pose), &static_heights, sweep++});
    for (const auto& [frame, pose] : dynamic_frames)
      clouds.push_back({&present(frame).dynamic_points, as_pose(pose), &dynamic_heights, sweep++});
  }
  PlacedClouds(const PlacedClouds&) = delete;
  PlacedClouds& operator=(const PlacedClouds&) = delete;
};

using PlacedFrame = std::pair<const MeshFrame*, Array<double>>;

inline PlacedMeshFrame as_mesh_frame(const PlacedFrame& placed) {
  return {&present(placed.first), as_pose(placed.second)};
}

inline std::vector<PlacedMeshFrame> as_mesh_frames(const std::vector<PlacedFrame>& placed) {
  std::vector<PlacedMeshFrame> result;
  for (const auto& frame : placed) result.push_back(as_mesh_frame(frame));
  return result;
}

/// A frame, its pose, and the time from its stamp to the image [s].
using DynamicFrame = std::tuple<const MeshFrame*, Array<double>, float>;

inline DynamicSweeps as_motion(const std::vector<DynamicFrame>& dynamic_frames, float max_speed) {
  DynamicSweeps motion{{}, in_range(max_speed, 0, 1e4, "max_speed")};
  for (const auto& [frame, pose, age] : dynamic_frames)
    motion.sweeps.push_back({{&present(frame), as_pose(pose)},
                             in_range(age, -kMaxDuration, kMaxDuration, "an age in seconds")});
  return motion;
}

}  // namespace docdepth::bindings
