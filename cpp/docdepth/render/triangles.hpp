// Surfaces drawn as triangles with perspective-correct depth into one z-buffer.
#pragma once

#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/mesh.hpp"

namespace docdepth {

/// A mesh where it stood relative to the camera at the image's time.
struct PlacedMesh {
  const Mesh* mesh;
  Pose T_camera_mesh;
  /// A pixel that an earlier mesh drew is only drawn over when this is nearer by more than this
  /// share of the depth: two measurements of one surface do not compete.
  float tolerance;
};

/// Depth of the nearest surface at each pixel, row after row; NaN where there is none. Meshes are
/// drawn in their order. Triangles with a corner nearer than kNear are left out. The result does
/// not depend on the number of threads.
std::vector<float> render_triangles(const Camera& camera, const std::vector<PlacedMesh>& meshes,
                                    int threads);

}  // namespace docdepth
