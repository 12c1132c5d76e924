// Layers of a depth map: where the depth of each pixel comes from.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/splats.hpp"
#include "docdepth/render/triangles.hpp"

namespace docdepth {

/// What rays around the shutter say of the depth of a pixel.
enum class Seen : std::uint8_t { kNotLookedAt = 0, kAgreed = 1, kContradicted = 2, kNoDepth = 255 };

/// Row after row, like the depth map.
struct Layers {
  std::vector<std::int32_t> sweep;      ///< number of the sweep; -1 if there is no depth
  std::vector<std::uint8_t> classid;    ///< ClassId, or kNoClass
  std::vector<std::uint16_t> instance;  ///< of a dynamic object; 0 if it is none
  std::vector<std::uint8_t> measured;   ///< 0 if a surface is only extrapolated over a jump
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

/// State of each pixel, row after row.
///
/// The four nearest rays around the drawn point, one in each quadrant of direction, tell, of all
/// that were measured within kShutter and lie within kNearRays. All four ended on the surface
/// there: agreed. All passed through: contradicted. All ended before it, on something that hides it
/// from the camera, too: contradicted. Else, also if one is missing: not looked at.
///
/// @param objects  number of the dynamic object of each pixel, from 0 on; -1 for static ones
std::vector<Seen> seen_pixels(const Camera& camera, const MeshScene& scene, const float* depth,
                              const std::vector<std::int32_t>& objects, int threads);

}  // namespace docdepth
