// Sweeps drawn as the surfaces that they measured.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/mesh.hpp"
#include "docdepth/render/motion.hpp"
#include "docdepth/render/rays.hpp"
#include "docdepth/render/triangles.hpp"

namespace docdepth {

/// A sweep's surface made ready to be drawn, each moving object apart.
struct MeshFrame {
  struct Mover {
    Mesh whole;  ///< measured surface, and returns that stand alone
    Mesh inner;  ///< what continues it over depth jumps of its own
    Mesh outer;  ///< what continues it towards others
  };
  Mesh world;  ///< measured surface, and returns that stand alone
  Rays rays;
  Objects objects;            ///< what moves
  std::vector<Mover> movers;  ///< each object

  /// @param triangles corners as rows of points
  /// @param cut 1 for each triangle across a depth jump
  /// @param loose rows of the returns that stand alone; each is drawn as a small diamond
  /// @param loose_angle half the diagonal of the diamond as the sensor sees it [rad]
  /// @param classid ClassId of every point
  /// @param late when every point was measured, seconds after the sweep's stamp; may be null
  /// @param starts where the line of sight of every point begins; may be null
  MeshFrame(const Points& points, const std::uint32_t (*triangles)[3], const std::uint8_t* cut,
            std::size_t triangle_count, const std::uint32_t* loose, std::size_t loose_count,
            float loose_angle, const std::uint16_t* classid, const float* late,
            const Points* starts = nullptr);
};

/// A sweep where it stood relative to the camera at the image's time.
struct PlacedMeshFrame {
  const MeshFrame* frame;
  Pose T_camera_frame;
};

/// The sweeps that tell of what moves, the nearest in time first; the next tells how fast it is.
struct Motion {
  struct Sweep {
    PlacedMeshFrame surface;
    float since;  ///< seconds from its stamp to the image
  };
  std::vector<Sweep> sweeps;
  float max_speed;  ///< metres per second
};

/// Depth map of what `fixed` measured of the world and what moves, row after row; NaN where there
/// is none.
///
/// The sweeps of `fixed` come by trust: the first is the nearest. Moving objects are carried along
/// their own motion to where they were when the image was taken.
///
/// @param witnesses number of sweeps of `fixed` whose rays are asked where sweeps differ; with 0
/// the
///   first to offer something is believed, and moving objects end a little past the middle between
///   returns
std::vector<float> render_meshes(const Camera& camera, const std::vector<PlacedMeshFrame>& fixed,
                                 const Motion& motion, int witnesses, int threads);

/// What render_meshes() draws, for any rasteriser of triangles. Its sweeps are numbered: those of
/// `fixed` from 0 on, then those of `motion`.
Drawing drawing_of(const Camera& camera, const std::vector<PlacedMeshFrame>& fixed,
                   const Motion& motion, int witnesses, int threads);

}  // namespace docdepth
