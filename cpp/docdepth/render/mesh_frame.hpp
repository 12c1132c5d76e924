// Sweeps made ready to be drawn as meshes, and the scene that they form at the time of an image.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/motion.hpp"
#include "docdepth/render/patch_mesh.hpp"
#include "docdepth/render/rays.hpp"
#include "docdepth/render/triangles.hpp"

namespace docdepth {

/// The mesh of a sweep made ready to be drawn, each dynamic object apart.
struct MeshFrame {
  struct DynamicMesh {
    PatchMesh whole;  ///< measured surface and isolated returns
    PatchMesh inner;  ///< continues it over its own discontinuities
    PatchMesh outer;  ///< continues it towards its surroundings
  };
  PatchMesh static_mesh;  ///< measured surface and isolated returns
  Rays rays;
  DynamicObjects objects;
  std::vector<DynamicMesh> dynamic_meshes;  ///< of each object

  /// @param triangles       corners as rows of points
  /// @param discontinuity   1 for each triangle across a depth jump
  /// @param isolated        rows of isolated returns; each is drawn as a small diamond
  /// @param isolated_angle  half the diagonal of the diamond as the sensor sees it [rad]
  /// @param classid         ClassId of every point
  /// @param time_offset     time of every point [s after the sweep's stamp]; may be null
  /// @param ray_origins     where the ray of every point starts; may be null
  MeshFrame(const Points& points, const std::uint32_t (*triangles)[3],
            const std::uint8_t* discontinuity, std::size_t triangle_count,
            const std::uint32_t* isolated, std::size_t isolated_count, float isolated_angle,
            const std::uint16_t* classid, const float* time_offset,
            const Points* ray_origins = nullptr);
};

struct PlacedMeshFrame {
  const MeshFrame* frame;
  Pose T_camera_frame;
};

/// Sweeps from which dynamic objects are drawn, the nearest in time first. The others tell how fast
/// each object is.
struct DynamicSweeps {
  struct Sweep {
    PlacedMeshFrame mesh;
    float age;  ///< from the sweep's stamp to the image [s]
  };
  std::vector<Sweep> sweeps;
  float max_speed;  ///< of objects [m/s]
};

/// Depth map of static surface and dynamic objects, row after row [m]; NaN if there is none.
///
/// @param static_frames      sweeps in the order of trust, the nearest first
/// @param dynamic            objects are moved to where they were at the time of the image
/// @param visibility_sweeps  number of static_frames whose rays decide where sweeps differ. With 0
///   the first sweep with a depth wins, and objects end a little past the middle between returns.
std::vector<float> render_meshes(const Camera& camera,
                                 const std::vector<PlacedMeshFrame>& static_frames,
                                 const DynamicSweeps& dynamic, int visibility_sweeps, int threads);

/// What render_meshes() draws, for any rasteriser. Sweeps are numbered: static_frames from 0 on,
/// then those of `dynamic`.
MeshScene compose_scene(const Camera& camera, const std::vector<PlacedMeshFrame>& static_frames,
                        const DynamicSweeps& dynamic, int visibility_sweeps, int threads);

}  // namespace docdepth
