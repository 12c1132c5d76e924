// What rays of several sweeps say of the depth of a pixel.
#pragma once

#include <vector>

#include "docdepth/geometry/rigid.hpp"
#include "docdepth/render/camera.hpp"
#include "docdepth/render/rays.hpp"

namespace docdepth {

constexpr int kMostHypotheses = 3;  ///< kept for a pixel

/// A pixel with several depths, the nearest first; 0 if there is none.
struct PixelHypotheses {
  int u, v;
  float hypotheses[kMostHypotheses];
};

// A ray that passes at distance d scores 1 / (d + blur)^2 [1/m^2], positive where it ended on a
// surface and negative where it passed through.

/// One ray within a centimetre, or many farther off, prove free space.
constexpr float kSureScore = 1000.0f;
/// The same for a surface. It takes more, since a ray may end next to a gap.
constexpr float kSureSurfaceScore = 1350.0f;

/// Scores hypothesis k of pixels by the rays of one sweep after the other, until the score is sure.
class VisibilityQueries {
 public:
  /// @param first_column  of the image that pixels are counted from
  VisibilityQueries(int first_column, const Camera& camera, const std::vector<SweepRays>& rays);

  /// @param free    score below which free space is sure, without its sign
  std::vector<float> score(const std::vector<PixelHypotheses>& pixels, int k,
                           float free = kSureScore) const;

 private:
  void score_batch(const PixelHypotheses* pixels, std::size_t count, int k, float free,
                   float* result) const;

  Eigen::Vector2f focal_, centre_;
  const std::vector<SweepRays>& rays_;
  std::vector<RigidTransform> to_rays_;
};

}  // namespace docdepth
