// Composite rendering of the paper (section V-B): each point is an upright disc, the nearest wins.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/cloud.hpp"

namespace docdepth {

/// Size of a splat [pixel]: sigma(p) = max(max / ln(|p|^2), min), and max nearer than
/// kLargestSplatRange.
struct SplatSize {
  double max, min;
};

/// Height of a splat in pixels, floor(sigma + 0.5), by the squared distance of its point from the
/// camera. A table with the exact borders: the same integers as the formula, without a logarithm.
class SplatHeights {
 public:
  explicit SplatHeights(const SplatSize& size);

  int operator()(float squared_distance) const;
  int largest() const { return static_cast<int>(limit_.size()) - 1; }
  /// Largest squared distance of each height.
  const std::vector<float>& limits() const { return limit_; }

 private:
  std::vector<float> limit_;          // largest squared distance of each height
  std::vector<std::uint16_t> guess_;  // height at the near end of a range of float patterns
};

/// A cloud in the frame of the camera at the time of the image.
struct PlacedCloud {
  const Cloud* cloud;
  Pose T_camera_cloud;
  const SplatHeights* heights;
  int sweep = 0;  ///< number of its sweep, chosen by the caller
};

/// Depth of the nearest splat at each pixel, row after row [m]; NaN if there is none.
///
/// A splat of height h is centred on the pixel nearest to its point's projection and covers the
/// offsets 9 du^2 + 4 dv^2 <= h^2: two thirds as wide as high, at the depth of its point.
/// Points nearer than kNear or with their centre outside the image are not drawn.
/// The result does not depend on the number of threads.
std::vector<float> render_splats(const Camera& camera, const std::vector<PlacedCloud>& clouds,
                                 int threads);

}  // namespace docdepth
