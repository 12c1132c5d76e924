// Arguments of the renderers.
#pragma once

#include <pybind11/stl.h>

#include <limits>
#include <tuple>

#include "arrays.hpp"
#include "docdepth/render/camera.hpp"
#include "docdepth/render/cloud.hpp"
#include "docdepth/render/layers.hpp"
#include "docdepth/render/mesh_frame.hpp"
#include "docdepth/render/splats.hpp"

namespace docdepth::bindings {

constexpr int kMaxSide = 1 << 16;                 ///< of an image [pixel]
constexpr std::int64_t kMaxPixels = 1 << 27;      ///< a depth map of 512 MB
constexpr double kMaxFocalLength = 1e6;           ///< [pixel]
constexpr double kMaxSplat = 2048.0;              ///< height of a splat [pixel]
constexpr double kMaxSplatPixels = 2147483648.0;  ///< of all heights together: 8 GB

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

/// A whole frame around the image, its pose, and the seconds from its stamp to
/// the image.
using ShutterOf = std::tuple<const MeshFrame*, Array<double>, double>;

inline std::vector<ShutterSweep> as_shutter_sweeps(const std::vector<ShutterOf>& frames) {
  constexpr double kMost = std::numeric_limits<float>::max();
  std::vector<ShutterSweep> result;
  for (const auto& [frame, pose, age] : frames)
    result.push_back(
        {{&present(frame), as_pose(pose)}, float(in_range(age, -kMost, kMost, "an age"))});
  return result;
}

/// ``T_camera_box`` of a box, its length, width and height, and its velocity in
/// the camera's frame.
using Triple = std::tuple<double, double, double>;
using BoxOf = std::tuple<Array<double>, Triple, Triple>;

inline std::vector<ObjectBox> as_boxes(const std::vector<BoxOf>& boxes) {
  std::vector<ObjectBox> result;
  const auto vector = [](const Triple& values, double least, double most, const char* what) {
    const auto& [x, y, z] = values;
    for (const double value : {x, y, z}) in_range(value, least, most, what);
    return Eigen::Vector3f(float(x), float(y), float(z));
  };
  for (const auto& [pose, size, velocity] : boxes)
    result.push_back({as_pose(pose), vector(size, 0, 1e3, "a side of a box [m]"),
                      vector(velocity, -1e3, 1e3, "a speed of a box [m/s]")});
  return result;
}

/// A frame, the number of the object in it, its pose, and the number of the
/// sweep.
using SightingOf = std::tuple<const MeshFrame*, int, Array<double>, int>;
/// Instance, sightings of sweeps around the image and of others, and those
/// whose rays tell where the object ends.
using ObjectOf =
    std::tuple<int, std::vector<SightingOf>, std::vector<SightingOf>, std::vector<SightingOf>>;

inline std::vector<ObjectView> as_sightings(const std::vector<SightingOf>& sightings) {
  std::vector<ObjectView> result;
  for (const auto& [frame, object_index, pose, sweep] : sightings) {
    const auto objects = static_cast<double>(present(frame).dynamic_meshes.size());
    in_range(object_index, 1, objects, "the number of an object in its frame");
    in_range(sweep, 0, kMaxRows, "the number of a sweep");
    result.push_back({{frame, as_pose(pose)}, std::uint32_t(object_index), sweep});
  }
  return result;
}

inline std::vector<ObjectViews> as_objects(const std::vector<ObjectOf>& objects) {
  std::vector<ObjectViews> result;
  for (const auto& [instance, around, others, rays] : objects) {
    in_range(instance, 0, 0xFFFF, "an instance");
    result.push_back(
        {std::uint16_t(instance), as_sightings(around), as_sightings(others), as_sightings(rays)});
  }
  return result;
}

/// What an image of meshes shows.
inline MeshScene as_scene(const Camera& camera, const std::vector<PlacedFrame>& static_frames,
                          const std::vector<ObjectOf>& objects, int visibility_sweeps,
                          const std::vector<ShutterOf>& shutter_sweeps,
                          const std::vector<BoxOf>& boxes = {}, int nearest_frames = 1) {
  in_range(visibility_sweeps, 0, kMaxRows, "visibility_sweeps");
  in_range(nearest_frames, 1, kMaxRows, "nearest_frames");
  std::vector<PlacedMeshFrame> frames;
  for (const auto& [frame, pose] : static_frames)
    frames.push_back({&present(frame), as_pose(pose)});
  return compose_scene(camera, frames, as_objects(objects), visibility_sweeps,
                       as_shutter_sweeps(shutter_sweeps), as_boxes(boxes), nearest_frames);
}

}  // namespace docdepth::bindings
