// The paper's composite rendering (section III-D): every point an upright disc, the nearest wins.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/cloud.hpp"

namespace docdepth {

/// sigma(p) = max(max / ln(|p|^2), min), pixels; max where |p| < 1.65 m (the logarithm below 1).
struct SplatSize {
  double max, min;
};

/// Height of a splat in whole pixels, floor(sigma + 0.5), of points at squared distance from the
/// camera. A table with the exact borders: same integers as the formula without its logarithm.
class SplatHeights {
 public:
  explicit SplatHeights(const SplatSize& size);

  int operator()(float squared_distance) const;
  int largest() const { return static_cast<int>(limit_.size()) - 1; }
  /// The largest squared distance at which each height is reached.
  const std::vector<float>& limits() const { return limit_; }

 private:
  std::vector<float> limit_;          // largest squared distance at which a height is reached
  std::vector<std::uint16_t> guess_;  // height at the near end of a range of float patterns
};

/// A cloud where it stood relative to the camera at the image's time.
struct PlacedCloud {
  const Cloud* cloud;
  Pose T_camera_cloud;
  const SplatHeights* heights;
  int sweep = 0;  ///< that it comes from, as a number of the caller's
};

/// Depth of the nearest splat at each pixel, row after row; NaN where there is none.
///
/// A splat of height h is centred on the pixel nearest to its point's projection and covers the
/// offsets 9 du^2 + 4 dv^2 <= h^2, two thirds as wide as high, all at the depth z of its point.
/// Points nearer than kNear or with their centre outside the image are not drawn.
/// The result does not depend on the number of threads.
std::vector<float> render_splats(const Camera& camera, const std::vector<PlacedCloud>& clouds,
                                 int threads);

}  // namespace docdepth
