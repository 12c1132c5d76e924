// What is known of each pixel of a depth map beside its depth.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/splats.hpp"
#include "docdepth/render/triangles.hpp"

namespace docdepth {

/// Depths that differ by less than this share of them are one surface.
constexpr float kAgree = 0.02f;

/// Row after row like the depth map that they belong to.
struct Layers {
  std::vector<std::int32_t> sweep;      ///< that the depth comes from; -1 where there is none
  std::vector<std::uint8_t> classid;    ///< ClassId
  std::vector<std::uint8_t> measured;   ///< 0 where a surface only goes on over a depth jump
  std::vector<float> range;             ///< metres from the sensor that measured it, else NaN
  std::vector<float> normal;            ///< x y z of the camera, towards it; empty for splats
  std::vector<std::uint16_t> support;   ///< measurements here that agree with the depth (kAgree)
  std::vector<std::uint16_t> measures;  ///< all measurements here
  std::vector<float> deviation;  ///< standard deviation of those that agree, metres; NaN if one

  Layers(const Camera& camera, bool with_normals);
};

/// Layers of a depth map that was drawn from the same sweeps, by any renderer; each sweep measures
/// a pixel once. The depth comes from the surface that is nearest to it.
Layers layers_of_triangles(const Camera& camera, const Drawing& drawing, const float* depth,
                           int threads);

/// The same of splats; each splat that covers a pixel measures it.
Layers layers_of_splats(const Camera& camera, const std::vector<PlacedCloud>& clouds,
                        const float* depth, int threads);

}  // namespace docdepth
