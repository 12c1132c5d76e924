#include "docdepth/render/surface_normals.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "docdepth/geometry/parallel.hpp"

namespace docdepth {
namespace {

/// Half a window at most, as a share of the focal length: three rings of a LiDAR of 64 beams.
constexpr double kReach = 0.022;
/// Half a window at least [pixel].
constexpr int kSmallest = 2;
/// Deviation of a surface from a plane [m]: the range noise of common LiDARs.
constexpr double kPlaneNoise = 0.02;

/// 1 / depth = a x + b y + c, where (x, y, 1) is the ray of a pixel. So (a, b, c) is its normal.
struct Plane {
  Eigen::Vector3f normal;
  float deviation = std::numeric_limits<float>::infinity();  ///< of the surface from it [m]
};

/// Sums over rectangles of an image: of 1, x, y, xx, xy, yy, w, wx, wy and ww, w = 1 / depth.
class Sums {
 public:
  using Moments = Eigen::Array<double, 10, 1>;

  Sums(const Camera& camera, const float* depth) : width_(camera.width), height_(camera.height) {
    sums_.resize(std::size_t(width_ + 1) * std::size_t(height_ + 1), Moments::Zero());
    for (int v = 0; v < height_; ++v) {
      Moments row = Moments::Zero();
      for (int u = 0; u < width_; ++u) {
        if (const double z = *depth++; z > 0) {
          const double x = (u - camera.cx) / camera.fx, y = (v - camera.cy) / camera.fy, w = 1 / z;
          row += Moments{{1, x, y, x * x, x * y, y * y, w, w * x, w * y, w * w}};
        }
        sums_[at(u + 1, v + 1)] = sums_[at(u + 1, v)] + row;
      }
    }
  }

  /// The plane through the pixels around one, if half of them have a depth.
  Plane plane_around(int u, int v, int half) const {
    const int left = std::max(u - half, 0), right = std::min(u + half + 1, width_);
    const int top = std::max(v - half, 0), bottom = std::min(v + half + 1, height_);
    const Moments sum = sums_[at(right, bottom)] - sums_[at(left, bottom)] - sums_[at(right, top)] +
                        sums_[at(left, top)];
    const int side = 2 * half + 1;
    if (2 * sum[0] < side * side) return {};
    const Moments m = sum / sum[0];
    const double xx = m[3] - m[1] * m[1], xy = m[4] - m[1] * m[2], yy = m[5] - m[2] * m[2];
    const double wx = m[7] - m[6] * m[1], wy = m[8] - m[6] * m[2], ww = m[9] - m[6] * m[6];
    const double determinant = xx * yy - xy * xy;  // half a window is no line
    const double a = (yy * wx - xy * wy) / determinant, b = (xx * wy - xy * wx) / determinant;
    const Eigen::Vector3d normal(a, b, m[6] - a * m[1] - b * m[2]);
    const double variance = std::max(ww - a * wx - b * wy, 0.0);
    return {normal.cast<float>(), float(std::sqrt(variance) / (m[6] * normal.norm()))};
  }

 private:
  std::size_t at(int u, int v) const {
    return std::size_t(v) * std::size_t(width_ + 1) + std::size_t(u);
  }

  int width_, height_;
  std::vector<Moments> sums_;
};

}  // namespace

std::vector<float> fit_normals(const Camera& camera, const float* depth, float* normal,
                               int threads) {
  const Sums sums(camera, depth);
  const std::size_t pixels = std::size_t(camera.width) * std::size_t(camera.height);
  std::vector<float> leans(pixels, std::numeric_limits<float>::infinity());
  std::vector<Plane> planes(pixels);
  for (int half = std::max(int(std::lround(kReach * camera.fx)), kSmallest); half >= kSmallest;
       half /= 2) {
    const auto for_each_pixel = [&](const auto& work) {
      parallel_for(std::size_t(camera.height), 16, threads,
                   [&](std::size_t begin, std::size_t end) {
                     for (int v = int(begin); v < int(end); ++v)
                       for (int u = 0; u < camera.width; ++u)
                         work(u, v, std::size_t(v) * std::size_t(camera.width) + std::size_t(u));
                   });
    };
    for_each_pixel([&](int u, int v, std::size_t i) { planes[i] = sums.plane_around(u, v, half); });
    for_each_pixel([&](int u, int v, std::size_t i) {
      if (std::isfinite(leans[i]) || !(depth[i] > 0)) return;
      const Eigen::Vector3f place = depth[i] * ray_of(camera, float(u), float(v));
      const Plane* best = nullptr;
      for (const int dv : {0, -half, half})
        for (const int du : {0, -half, half}) {
          if (u + du < 0 || u + du >= camera.width || v + dv < 0 || v + dv >= camera.height)
            continue;
          const Plane& plane =
              planes[std::size_t(v + dv) * std::size_t(camera.width) + std::size_t(u + du)];
          if (!(plane.deviation < (best ? best->deviation : float(kPlaneNoise)))) continue;
          const float away = std::fabs(plane.normal.dot(place) - 1) / plane.normal.norm();
          if (away < float(kPlaneNoise)) best = &plane;
        }
      if (!best) return;
      Eigen::Map<Eigen::Vector3f>(normal + 3 * i) = -best->normal.normalized();
      leans[i] = best->deviation / (float(half) / float(camera.fx) * depth[i]);
    });
  }
  return leans;
}

}  // namespace docdepth
