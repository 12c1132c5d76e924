// A key frame as the paper's range image (III-C2, Algorithm 1).
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/dynamics/key_frame.hpp"
#include "docdepth/geometry/spherical.hpp"

namespace docdepth {

/// Parameters of Algorithm 1.
struct RangeImageParameters {
  double resolution = 0.2 * 3.14159265358979323846 / 180.0;  ///< pixel, d_theta = d_phi [rad]
  int window = 5;                                            ///< edge w [pixel], odd
  float tolerance = 0.2f;                                    ///< tau [m]
  bool plain = false;  ///< vote by the plain loop, the reference that the fast way must equal
};

/// For each pixel the nearest return and whether that one is ground.
class RangeImage : public KeyFrame {
 public:
  /// @param ground  one flag a point.
  /// Points that are not finite or lie at the origin are left out.
  RangeImage(const Points& points, const bool* ground, const RangeImageParameters& parameters);

  /// Algorithm 1 on every point.
  void vote(const QueryPoints& points, std::uint16_t* statics,
            std::uint16_t* dynamics) const override;

 private:
  enum class Vote { kNone, kStatic, kDynamic };

  void draw(const Points& points, const bool* ground);
  void summarize_windows();
  void vote_fast(const QueryPoints& points, std::uint16_t* statics, std::uint16_t* dynamics) const;
  void vote_plainly(const QueryPoints& points, std::uint16_t* statics,
                    std::uint16_t* dynamics) const;
  Vote ask(float range, std::size_t pixel) const;

  SphericalGrid grid_;
  int half_;         ///< pixels of the window on either side of its centre
  float tolerance_;  ///< tau
  bool plain_;
  int top_ = 0;         ///< row of the grid that is the first of the images
  int rows_ = 0;        ///< the occupied rows, and as many empty ones as windows there can reach
  std::size_t stride_;  ///< columns, and half_ repeated ones at either end
  std::vector<float> range_;          ///< nearest return, infinite where there is none
  std::vector<std::uint8_t> ground_;  ///< whether that is ground

  // What the window around each pixel holds, so that one look settles most votes.
  std::vector<float> settling_;  ///< nearest return; around ground minus the farthest; 0 for none
  std::vector<float> farthest_;  ///< farthest return
  float tie_free_;  ///< from this range on no difference of two ranges equals the tolerance
};

}  // namespace docdepth
