// Sweeps made ready to be drawn as meshes, and the scene that they form at the time of an image.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/patch_mesh.hpp"
#include "docdepth/render/rays.hpp"
#include "docdepth/render/triangles.hpp"

namespace docdepth {

/// How an object moves in the frame of the sensor.
struct ObjectMotion {
  Eigen::Vector3f velocity;  ///< [m/s]
  float time;                ///< at which the object is held [s after the sweep's stamp]
};

/// What a mesh frame is made of: the scan mesh of a sweep, and to whom each return belongs.
struct MeshParts {
  const Points& points;
  const std::uint32_t (*triangles)[3];  ///< corners as rows of points
  const std::uint8_t* discontinuity;    ///< 1 for each triangle across a depth jump
  std::size_t triangle_count;
  const std::uint32_t* isolated;  ///< rows of isolated returns; each is drawn as a small diamond
  std::size_t isolated_count;
  float isolated_angle;          ///< half the diagonal of the diamond as the sensor sees it [rad]
  const std::uint16_t* classid;  ///< ClassId of every point
  const std::uint16_t* object_index;  ///< of every point: 0 the static surface, 1, 2, ... objects
  const std::vector<ObjectMotion>& motions;  ///< of object 1, 2, ...
  const std::uint8_t* drawn;   ///< of object 1, 2, ...: 0 if nobody draws it; null if all are drawn
  const float* time_offset;    ///< of every point [s after the sweep's stamp]; may be null
  const Points* displacement;  ///< moves every point to the time of its object; may be null
  const Points* ray_origins;   ///< where the ray of every point starts; may be null
};

/// The mesh of a sweep made ready to be drawn, each dynamic object apart.
struct MeshFrame {
  struct DynamicMesh {
    PatchMesh whole;  ///< measured surface and isolated returns
    PatchMesh inner;  ///< extrapolates it over its own discontinuities
    PatchMesh outer;  ///< extrapolates it towards its surroundings
    Rays rays;        ///< near it, as object_rays() moves them
  };
  PatchMesh static_mesh;                    ///< measured surface and isolated returns
  PatchMesh static_outer;                   ///< extrapolates it over what may be hidden behind it
  Rays rays;                                ///< as they were measured
  std::vector<DynamicMesh> dynamic_meshes;  ///< of object 1, 2, ...; empty if it is not drawn

  explicit MeshFrame(const MeshParts& parts);
};

/// For each object the rays that ended on it or passed beside it, each moved with the object from
/// the time of its measurement to the time at which the object is held. So the object stands still
/// among them.
/// @param normals  of the surface at each point
std::vector<Rays> object_rays(const MeshParts& parts, const std::vector<Eigen::Vector3f>& normals);

struct PlacedMeshFrame {
  const MeshFrame* frame;
  Pose T_camera_frame;
};

/// A whole sweep around the image.
struct ShutterSweep {
  PlacedMeshFrame placed;
  float age;  ///< from the sweep's stamp to the image [s]
};

/// What a sweep saw of an object, placed where the object is at the time of the image.
struct ObjectView {
  PlacedMeshFrame placed;
  std::uint32_t object_index;  ///< number of the object in the frame, from 1 on
  int sweep;                   ///< number of the sweep, chosen by the caller
};

/// A dynamic object as several sweeps saw it.
struct ObjectViews {
  std::uint16_t instance;          ///< 0 if it is not followed
  std::vector<ObjectView> around;  ///< sweeps around the image; the first is drawn as it is
  std::vector<ObjectView> others;  ///< sweeps farther in time, which saw other parts of it
  std::vector<ObjectView> rays;    ///< that tell where it ends
};

/// The scene of static surface and dynamic objects, for any rasteriser.
///
/// @param static_frames      sweeps in the order in which they win, the nearest first; of several
/// LiDARs a
///   frame for each
/// @param visibility_sweeps  number of static_frames whose rays decide where sweeps differ. With 0
///   the first sweep with a depth wins.
/// @param shutter_sweeps     sweeps nearest in time to the image, the nearest first; these are the
///   sweeps static_frames.size(), static_frames.size() + 1, ... of sightings
/// @param boxes              around objects that move; see mask_unobserved_background()
/// @param nearest_frames     number of static_frames of the nearest sweep, at least 1: they are
///   drawn as they are, and between its last return and the next ray each may hide what is farther
MeshScene compose_scene(const Camera& camera, const std::vector<PlacedMeshFrame>& static_frames,
                        const std::vector<ObjectViews>& objects, int visibility_sweeps,
                        const std::vector<ShutterSweep>& shutter_sweeps,
                        const std::vector<ObjectBox>& boxes, int nearest_frames);

}  // namespace docdepth
