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
};

/// For each pixel the nearest return and whether that one is ground.
class RangeImage : public KeyFrame {
 public:
  /// @param ground  one flag a point.
  /// Points that are not finite or lie at the origin are left out.
  RangeImage(const Points& points, const bool* ground, const RangeImageParameters& parameters);

  /// Algorithm 1, a point at a time.
  void vote(const QueryPoints& points, std::uint16_t* statics,
            std::uint16_t* dynamics) const override;

 private:
  enum class Vote { kNone, kStatic, kDynamic };
  Vote ask(float range, std::size_t pixel) const;

  /// Where the pixel at (row, column) is in the images; rows that no return is near have none.
  bool find(int row, int column, std::size_t* pixel) const;

  SphericalGrid grid_;
  int half_;            ///< pixels of the window on either side of its centre
  float tolerance_;     ///< tau
  int first_row_ = 0;   ///< first occupied row of the grid
  int rows_ = 0;        ///< occupied rows; the images have `2 half_` empty ones above and below
  std::size_t stride_;  ///< columns of the images: `half_` repeated ones on either side
  std::vector<float> range_;  ///< nearest return, infinite where there is none
  std::vector<std::uint8_t> ground_;
};

}  // namespace docdepth
