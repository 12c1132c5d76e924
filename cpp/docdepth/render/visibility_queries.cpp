#include "docdepth/render/visibility_queries.hpp"

#include <algorithm>

namespace docdepth {

VisibilityQueries::VisibilityQueries(int first_column, const Camera& camera,
                                     const std::vector<SweepRays>& rays)
    : focal_(camera.fx, camera.fy),
      centre_(float(camera.cx) - float(first_column), camera.cy),
      rays_(rays) {
  for (const auto& placed : rays) to_rays_.emplace_back(placed.T_camera_rays.inverse());
}

std::vector<float> VisibilityQueries::score(const std::vector<PixelHypotheses>& pixels, int k,
                                            float free) const {
  std::vector<float> result(pixels.size(), 0.0f);
  for (std::size_t first = 0; first < pixels.size(); first += PointBatch::kMax)
    score_batch(&pixels[first], std::min(pixels.size() - first, PointBatch::kMax), k, free,
                &result[first]);
  return result;
}

void VisibilityQueries::score_batch(const PixelHypotheses* pixels, std::size_t count, int k,
                                    float free, float* result) const {
  Eigen::Vector3f targets[PointBatch::kMax];
  for (std::size_t i = 0; i < count; ++i) {
    const float depth = 1 / pixels[i].hypotheses[k];
    targets[i] = {(float(pixels[i].u) - centre_.x()) / focal_.x() * depth,
                  (float(pixels[i].v) - centre_.y()) / focal_.y() * depth, depth};
  }
  std::uint32_t open[PointBatch::kMax];  // targets whose score is not sure yet
  for (std::uint32_t i = 0; i < count; ++i) open[i] = i;
  float scores[PointBatch::kMax] = {};
  PointBatch seen;
  seen.size = count;
  for (std::size_t j = 0; j < rays_.size() && seen.size > 0; ++j) {
    for (std::size_t n = 0; n < seen.size; ++n) {
      const Eigen::Vector3f p = to_rays_[j] * targets[open[n]];
      seen.x[n] = p.x();
      seen.y[n] = p.y();
      seen.z[n] = p.z();
    }
    rays_[j].rays->query_visibility(seen, rays_[j].blur, scores);
    std::size_t left = 0;
    for (std::size_t n = 0; n < seen.size; ++n) {
      result[open[n]] = scores[n];
      if (scores[n] >= kSureSurfaceScore || scores[n] <= -free) continue;
      open[left] = open[n];
      scores[left++] = scores[n];
    }
    seen.size = left;
  }
}

}  // namespace docdepth
