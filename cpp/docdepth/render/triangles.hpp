// Surfaces drawn into a depth map: triangles with perspective-correct depth.
#pragma once

#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/mesh.hpp"
#include "docdepth/render/rays.hpp"

namespace docdepth {

/// A mesh where it stood relative to the camera at the image's time.
struct PlacedMesh {
  const Mesh* mesh;
  Pose T_camera_mesh;
  int sweep = 0;       ///< that it comes from, as a number of the caller's
  bool split = false;  ///< not measured, it only goes on over a depth jump
};

/// A moving object where it was when the image was taken, as one or more sweeps saw it.
struct PlacedMover {
  std::vector<PlacedMesh> trusted;  ///< is drawn unquestioned
  std::vector<PlacedMesh> others;   ///< fill what it left empty, where rays met them
  std::vector<PlacedRays> rays;     ///< placed so that the object stands still among them
};

/// What is drawn, in this order. Two sweeps never measure quite the same, so the nearest of all
/// surfaces is not the best: it is the one with the most noise and the widest silhouette.
struct Drawing {
  std::vector<PlacedMesh> trusted;  ///< goes on unquestioned where it has no edge
  std::vector<PlacedMesh> others;   ///< fill what it left empty, and are offered at its edges
  std::vector<PlacedRays> rays;     ///< are asked where offers differ
  std::vector<PlacedMover> movers;  ///< hide what is farther
};

/// Depth of the surface at each pixel, row after row; NaN where there is none. Triangles with a
/// corner nearer than kNear are left out. The result does not depend on the number of threads.
std::vector<float> render_triangles(const Camera& camera, const Drawing& drawing, int threads);

}  // namespace docdepth
