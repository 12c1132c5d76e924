// Layers of a depth map: where the depth of each pixel comes from.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/seen.hpp"
#include "docdepth/render/splats.hpp"
#include "docdepth/render/triangles.hpp"

namespace docdepth {

/// Row after row, like the depth map.
struct Layers {
  std::vector<std::int32_t> sweep;      ///< number of the sweep; -1 if there is no depth
  std::vector<std::uint8_t> classid;    ///< ClassId, or kNoClass
  std::vector<std::uint16_t> instance;  ///< of a dynamic object; 0 if it is none
  std::vector<std::uint8_t> measured;   ///< 0 if a surface is only continued over a discontinuity
  std::vector<float> range;             ///< from the sensor that measured it [m]; NaN if none
  std::vector<float> normal;            ///< x y z in the camera frame, towards it; none of splats
  std::vector<std::uint16_t> support;   ///< measurements that agree with the depth (kAgree)
  std::vector<std::uint16_t> measures;  ///< all measurements of the pixel
  std::vector<float> deviation;  ///< standard deviation of the support [m]; NaN of less than two

  std::vector<Seen> seen;  ///< empty unless cached for; none of splats

  Layers(const Camera& camera, bool with_normals);
};

/// Layers of a depth map that any renderer drew from the same sweeps. Each sweep measures a pixel
/// once; the depth comes from the surface nearest to it.
/// @param with_seen  whether `seen` is cached for, too
Layers layers_of_triangles(const Camera& camera, const MeshScene& scene, const float* depth,
                           bool with_seen, int threads);

/// The same for splats. Each splat that covers a pixel is a measurement.
Layers layers_of_splats(const Camera& camera, const std::vector<PlacedCloud>& clouds,
                        const float* depth, int threads);

}  // namespace docdepth
