// Surfaces drawn into a depth map: triangles with perspective-correct depth.
#pragma once

#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/mesh.hpp"

namespace docdepth {

/// A mesh where it stood relative to the camera at the image's time.
struct PlacedMesh {
  const Mesh* mesh;
  Pose T_camera_mesh;
  int sweep = 0;       ///< that it comes from, as a number of the caller's
  bool split = false;  ///< not measured, it only goes on over a depth jump
};

/// Depths that differ by less than this share of them are one surface.
constexpr float kAgree = 0.02f;

/// What is drawn, in this order. Two sweeps never measure quite the same, so the nearest of all
/// surfaces is not the best: it is the one with the most noise and the widest silhouette.
struct Drawing {
  std::vector<PlacedMesh> trusted;  ///< nothing but what moves is drawn over these
  /// Each fills what those before it left empty. It is drawn over them only where two agree that
  /// something is nearer.
  std::vector<PlacedMesh> others;
  std::vector<PlacedMesh> movers;  ///< hide what is farther
};

/// Depth of the surface at each pixel, row after row; NaN where there is none. Triangles with a
/// corner nearer than kNear are left out. The result does not depend on the number of threads.
std::vector<float> render_triangles(const Camera& camera, const Drawing& drawing, int threads);

}  // namespace docdepth
