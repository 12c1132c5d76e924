// A key frame as an image of its mesh: it also votes between its returns. Beyond the paper.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/mesh/scan_mesh.hpp"
#include "docdepth/voting/key_frame.hpp"
#include "docdepth/voting/padded_range_image.hpp"

namespace docdepth {

/// A point lies on a plane if it is within one of two distances.
struct Margins {
  float normal_tolerance;  ///< along the normal [m]
  float radial_tolerance;  ///< along the ray [m]
  float radial_growth;     ///< growth of radial_tolerance with range [m/m]
};

struct MeshImageParameters {
  /// Pixel size [rad].
  double resolution = kImageResolution;
  /// Edge of the window of returns [pixel], odd.
  int window = kWindow;
  /// Range tolerance of a single return, tau of the paper [m].
  float tolerance = kRangeTolerance;
  /// Margins of planes that are not level.
  Margins upright{0.2f, 0.3f, 0.01f};
  /// Margins of level planes, narrower since the feet of objects are just above them.
  Margins level{0.08f, 0.1f, 0.0f};
  /// normal_tolerance of a level plane if the point or the plane is labelled ground [m]: its height
  /// is exact to millimetres.
  float ground_tolerance = 0.03f;
  /// A plane is level if its unit normal's component along `up` is above this: a lean of 25
  /// degrees.
  float level_cosine = 0.9063078f;
  /// Unit vector that points up in the frame of the points: a LiDAR may be mounted at any angle.
  std::array<float, 3> up{0.0f, 0.0f, 1.0f};
  /// A triangle does not vote on points farther from the rays to its corners [m].
  float max_ray_distance = 0.15f;
};

/// The triangle that holds the centre of each pixel, and the nearest return.
class MeshImage : public KeyFrame {
 public:
  /// Points that are not finite or lie at the origin are left out.
  MeshImage(const Points& points, const bool* ground, const ScanMesh& mesh,
            const MeshImageParameters& parameters);

  /// Compare each point with the plane of the triangle in its direction: on it static, before it
  /// dynamic, behind it no vote. Across a discontinuity only points nearer than all three corners
  /// are dynamic.
  ///
  /// A return of the same range in the window makes a point static, unless the triangle is level:
  /// window and ground would make the feet of all objects static. A triangle has no vote far from
  /// the rays to its corners: between the rings of a sparse sensor it spans over balconies and
  /// posts that no ray met.
  ///
  /// The margin is narrower if the point, or all corners of the triangle, are labelled ground: the
  /// feet of a pedestrian are only a few centimetres above it.
  void vote(const QueryPoints& points, const std::int32_t* pixels, std::uint16_t* static_votes,
            std::uint16_t* dynamic_votes) const override;
  void find(const QueryPoints& points, std::int32_t* pixels) const override;
  bool votes_on_ground() const override { return true; }

 private:
  /// What a pixel keeps, in sixteen bytes: the cost of a vote is that of fetching it.
  struct Pixel {
    /// Unit normal of the plane over its distance from the sensor, zeros for no plane; or the
    /// ranges of the three corners of a discontinuity.
    float values[3];
    /// Discontinuity, ranges of the window, ground, distance of the nearest corner
    /// (mesh_image.cpp).
    std::uint32_t bits;
  };

  Pixel make_pixel(const Points& points, const bool* ground,
                   const std::array<std::uint32_t, 3>& corners, bool discontinuity) const;
  void draw(const Points& points, const bool* ground, const ScanMesh& mesh);
  void summarize_windows();

  MeshImageParameters parameters_;
  PaddedRangeImage padded_;
  std::vector<Pixel> pixels_;
  std::vector<float> range_;  ///< nearest return [m], or kEmpty
};

}  // namespace docdepth
