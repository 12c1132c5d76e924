// A key frame as the surface that it measured: it answers between its returns, too.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/dynamics/canvas.hpp"
#include "docdepth/dynamics/key_frame.hpp"
#include "docdepth/surface/surface.hpp"

namespace docdepth {

/// How near to a plane a point lies on it: by its distance from the plane, or along the line of
/// sight.
struct Margins {
  float normal_tolerance;  ///< [m]
  float radial_tolerance;  ///< [m]
  float radial_growth;     ///< of `along` with range [m/m]
};

struct MeshImageParameters {
  double resolution = 0.2 * 3.14159265358979323846 / 180.0;  ///< edge of a pixel [rad]
  int window = 5;          ///< edge of the window of returns [pixel], odd
  float tolerance = 0.2f;  ///< of single returns, tau [m]
  Margins upright{0.2f, 0.3f, 0.01f};
  Margins level{0.08f, 0.1f, 0.0f};  ///< of planes that lie flat, as ground does
  float ground_tolerance = 0.03f;    ///< `across` of these if point or plane is called ground [m]
  float level_cosine = 0.906307787f;  ///< planes whose normal leans no more are level: 25 deg
  float max_ray_distance = 0.15f;    ///< what lies farther from a line of sight is not seen [m]
};

/// For each pixel the triangle of the surface that its centre lies in, and the nearest return.
class MeshImage : public KeyFrame {
 public:
  /// Points that are not finite or lie at the origin are left out.
  MeshImage(const Points& points, const bool* ground, const ScanMesh& mesh,
            const MeshImageParameters& parameters);

  /// Each point is held against the plane of the triangle in its direction: on it static, before it
  /// dynamic, behind it unknown. Across a depth jump nothing is known but that what lies nearer
  /// than all three corners was looked through. But a return of the same range nearby is static,
  /// unless the triangle lies flat: window and ground would find the feet of everything. And a
  /// triangle tells nothing about what lies far from the lines of sight to its corners: between the
  /// rings of a sparse sensor it bridges balconies and posts that none of them met.
  ///
  /// Ground is level and its heights are exact to millimetres, so what was called ground has a
  /// narrower margin, be it the point or all corners of the triangle: the feet of what moves lie a
  /// few centimetres higher.
  void vote(const QueryPoints& points, const std::int32_t* pixels, std::uint16_t* statics,
            std::uint16_t* dynamics) const override;
  void find(const QueryPoints& points, std::int32_t* pixels) const override;
  bool asks_ground() const override { return true; }

 private:
  /// What lies in the direction of a pixel, in sixteen bytes: that many fetches from memory are
  /// what a vote costs.
  struct Seen {
    /// Unit normal of the plane over its distance from the sensor, zeros for no plane; or the
    /// ranges of the three corners around a depth jump.
    float values[3];
    /// Whether it is a jump, between what ranges the returns of the window lie, whether it is
    /// ground, and how far the nearest corner is from the centre of the pixel.
    std::uint32_t bits;
  };

  Seen triangle(const Points& points, const bool* ground,
                const std::array<std::uint32_t, 3>& corners, bool cut) const;
  void draw(const Points& points, const bool* ground, const ScanMesh& mesh);
  void summarize_windows();
  MeshImageParameters parameters_;
  Canvas canvas_;
  std::vector<Seen> seen_;
  std::vector<float> range_;  ///< nearest return, infinite where there is none
};

}  // namespace docdepth
