// Meshes drawn into a depth map: triangles with perspective-correct depth.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/patch_mesh.hpp"
#include "docdepth/render/rays.hpp"

namespace docdepth {

/// A mesh in the frame of the camera at the time of the image.
struct PlacedMesh {
  const PatchMesh* mesh;
  Pose T_camera_mesh;
  int sweep = 0;               ///< number of its sweep, chosen by the caller
  bool split = false;          ///< not measured: it extrapolates a surface over a discontinuity
  std::uint16_t instance = 0;  ///< of the object; 0 if it is none
};

/// A dynamic object at the time of the image, as one or more sweeps saw it.
struct DynamicObjectScene {
  std::vector<PlacedMesh> nearest;       ///< drawn as they are
  std::vector<PlacedMesh> others;        ///< drawn where no rays contradict or doubt them
  std::vector<PlacedMesh> extrapolated;  ///< extrapolate both; drawn where rays confirm them
  /// Placed so that the object stands still among them; of the sweeps nearest in time first.
  std::vector<SweepRays> rays;
  PixelBounds bounds;  ///< all of it lies within
};

/// The box around an object that moves, at the time of the image.
struct ObjectBox {
  Pose T_camera_box;  ///< x forward, z up; the origin is the centre of the bottom
  Eigen::Vector3f size;
  Eigen::Vector3f velocity;  ///< in the frame of the camera [m/s]
};

/// What is drawn, in this order. Two sweeps never measure quite the same, so the nearest of all
/// surfaces would be the one with the most noise and the widest silhouette.
struct MeshScene {
  std::vector<PlacedMesh> nearest;  ///< of the nearest sweep; drawn as they are, except at edges
  std::vector<PlacedMesh> others;   ///< fill what is left empty, and are hypotheses at edges
  std::vector<SweepRays> rays;      ///< decide between hypotheses
  std::vector<DynamicObjectScene> dynamic_objects;  ///< hide what is farther
  std::vector<SweepRays> shutter_rays{};            ///< of the sweeps nearest in time to the image
  std::vector<PlacedMesh> extrapolated{};  ///< extrapolate `nearest`, and may hide what is farther
  std::vector<ObjectBox> boxes{};          ///< around what moves; see mask_unobserved_background()
};

/// Mean distance between returns of the nearest sweep [pixel]; 0 if the scene has no rays.
float return_spacing(const Camera& camera, const MeshScene& scene);

/// Depth of the surface at each pixel, row after row [m]; NaN if there is none. Triangles with a
/// corner nearer than kNear are left out. The result does not depend on the number of threads.
std::vector<float> render_triangles(const Camera& camera, const MeshScene& scene, int threads);

}  // namespace docdepth
