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
};

/// Meshes among which the nearest surface wins.
struct Layer {
  std::vector<PlacedMesh> meshes;
  /// Does it hide what lies farther in the layers before it? If not, it is drawn only where these
  /// left pixels empty.
  bool hides = false;
};

/// Depth of the surface at each pixel, row after row; NaN where there is none. Layers are drawn in
/// their order. Triangles with a corner nearer than kNear are left out. The result does not depend
/// on the number of threads.
std::vector<float> render_triangles(const Camera& camera, const std::vector<Layer>& layers,
                                    int threads);

}  // namespace docdepth
