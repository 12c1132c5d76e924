// Sweeps drawn as the surfaces that they measured.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/triangles.hpp"

namespace docdepth {

/// A sweep's surface made ready to be drawn, what moves apart from what does not.
struct SurfaceFrame {
  struct Parts {
    Mesh whole;  ///< measured surface, and returns that stand alone
    Mesh split;  ///< what continues it half way over depth jumps
  };
  Parts fixed, moving;

  /// @param triangles corners as rows of points
  /// @param cut 1 for each triangle across a depth jump
  /// @param loose rows of the returns that stand alone; each is drawn as a small diamond
  /// @param loose_angle half the diagonal of the diamond as the sensor sees it [rad]
  /// @param classid ClassId of every point
  SurfaceFrame(const Points& points, const std::uint32_t (*triangles)[3], const std::uint8_t* cut,
               std::size_t triangle_count, const std::uint32_t* loose, std::size_t loose_count,
               float loose_angle, const std::uint16_t* classid);
};

/// A sweep where it stood relative to the camera at the image's time.
struct PlacedSurface {
  const SurfaceFrame* frame;
  Pose T_camera_frame;
};

/// Depth map of what `fixed` measured of the world and `moving` of what moves, row after row; NaN
/// where there is none.
///
/// Two sweeps never measure quite the same. So sweeps are not mixed: each fills what those before
/// it left empty, and the most trustworthy, which is the nearest, comes first.
std::vector<float> render_surfaces(const Camera& camera, const std::vector<PlacedSurface>& fixed,
                                   const PlacedSurface& moving, int threads);

/// The same as layers, for any rasteriser of triangles.
std::vector<Layer> surface_layers(const std::vector<PlacedSurface>& fixed,
                                  const PlacedSurface& moving);

}  // namespace docdepth
