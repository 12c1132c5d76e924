// Milliseconds a depth map, and how many times faster than drawing every disc or triangle plainly.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <limits>
#include <random>

#include "docdepth/geometry/rigid.hpp"
#include "docdepth/mesh/scan_mesh.hpp"
#include "docdepth/render/cloud.hpp"
#include "docdepth/render/mesh_frame.hpp"
#include "docdepth/render/splats.hpp"
#include "keep_memory.hpp"

using namespace docdepth;

namespace {

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

double median_ms(int runs, const std::function<void()>& work) {
  std::vector<double> times;
  for (int i = 0; i < runs; ++i) {
    const auto start = std::chrono::steady_clock::now();
    work();
    times.push_back(
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start)
            .count());
  }
  std::nth_element(times.begin(), times.begin() + runs / 2, times.end());
  return times[runs / 2];
}

/// A spinning sensor of 64 rings in a street: road, facades 9 m to the sides with houses ahead.
Matrix street_sweep(int count, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> noise(0.0f, 0.02f);
  Matrix points(count, 3);
  for (int i = 0; i < count; ++i) {
    const double azimuth = 2 * M_PI * (i / 64) / (count / 64);
    const double elevation = (2.0 - 26.8 * (i % 64) / 63.0) * M_PI / 180;
    const Eigen::Vector3d ray(std::cos(azimuth) * std::cos(elevation),
                              std::sin(azimuth) * std::cos(elevation), std::sin(elevation));
    double range = std::min(9.0 / std::abs(ray.y()), 60.0 / std::abs(ray.x()));
    if (ray.z() < 0) range = std::min(range, -1.73 / ray.z());
    points.row(i) = ((range + noise(random)) * ray).cast<float>();
  }
  return points;
}

/// Each disc drawn where it falls, one thread.
std::vector<float> plain(const Camera& c, const std::vector<Matrix>& sweeps,
                         const std::vector<PlacedCloud>& placed) {
  std::vector<float> depth(c.width * c.height, INFINITY);
  for (std::size_t k = 0; k < sweeps.size(); ++k) {
    const RigidTransform T(placed[k].T_camera_cloud);
    for (Eigen::Index i = 0; i < sweeps[k].rows(); ++i) {
      const Eigen::Vector3f p = T * Eigen::Vector3f(sweeps[k].row(i));
      if (!(p.z() > kNear)) continue;
      const float u = float(c.fx) * p.x() / p.z() + float(c.cx) + 0.5f;
      const float v = float(c.fy) * p.y() / p.z() + float(c.cy) + 0.5f;
      if (!(u >= 0 && u < float(c.width) && v >= 0 && v < float(c.height))) continue;
      const int h = (*placed[k].heights)((p.x() * p.x() + p.y() * p.y()) + p.z() * p.z());
      for (int dv = -h / 2; dv <= h / 2; ++dv) {
        const int row = int(v) + dv;
        if (row < 0 || row >= c.height) continue;
        const int half = int(std::sqrt(double(h * h - 4 * dv * dv)) / 3 + 1e-9);
        for (int u1 = std::max(0, int(u) - half); u1 <= std::min(c.width - 1, int(u) + half); ++u1)
          depth[row * c.width + u1] = std::min(depth[row * c.width + u1], p.z());
      }
    }
  }
  return depth;
}

/// Each triangle of each sweep drawn where it falls, in double precision, one thread.
std::vector<float> plain(const Camera& c, const std::vector<Matrix>& sweeps,
                         const std::vector<ScanMesh>& surfaces, const std::vector<Pose>& poses) {
  std::vector<float> depth(c.width * c.height, INFINITY);
  for (std::size_t k = 0; k < surfaces.size(); ++k)
    for (std::size_t t = 0; t < surfaces[k].triangles.size(); ++t) {
      Eigen::Vector3d p[3];  // u, v, 1 / z
      bool before = surfaces[k].discontinuity[t] == 0;
      for (int i = 0; i < 3; ++i) {
        const Eigen::Vector3f point = sweeps[k].row(surfaces[k].triangles[t][i]);
        const Eigen::Vector3d q = poses[k] * point.cast<double>();
        before = before && q.z() > kNear;
        p[i] = {c.fx * q.x() / q.z() + c.cx, c.fy * q.y() / q.z() + c.cy, 1 / q.z()};
      }
      if (!before) continue;
      const auto low = p[0].cwiseMin(p[1]).cwiseMin(p[2]).eval();
      const auto high = p[0].cwiseMax(p[1]).cwiseMax(p[2]).eval();
      const auto cross = [](const Eigen::Vector3d& a, const Eigen::Vector3d& b, double u,
                            double v) {
        return (b.x() - a.x()) * (v - a.y()) - (b.y() - a.y()) * (u - a.x());
      };
      const double area = cross(p[0], p[1], p[2].x(), p[2].y());
      for (int v = std::max(0, int(std::ceil(low.y()))); v <= high.y() && v < c.height; ++v)
        for (int u = std::max(0, int(std::ceil(low.x()))); u <= high.x() && u < c.width; ++u) {
          const double a = cross(p[1], p[2], u, v) / area, b = cross(p[2], p[0], u, v) / area;
          if (!(a >= 0 && b >= 0 && a + b <= 1)) continue;
          const double z = 1 / (a * p[0].z() + b * p[1].z() + (1 - a - b) * p[2].z());
          depth[v * c.width + u] = std::min(depth[v * c.width + u], float(z));
        }
    }
  return depth;
}

/// The default: sweeps as meshes, at the distances at which static_frames() takes them.
void measure_surfaces(const Camera& camera, const std::vector<Matrix>& sweeps,
                      const Pose& T_camera_lidar) {
  const std::vector<std::uint16_t> classid(sweeps[0].rows(), 50), owner(sweeps[0].rows(), 0);
  std::vector<ScanMesh> surfaces;
  std::vector<MeshFrame> frames;
  std::vector<PlacedMeshFrame> placed;
  std::vector<Pose> poses;
  const auto frame_of = [&](std::size_t k) {
    const ScanMesh& s = surfaces[k];
    const Points points = sweeps[k];
    return MeshFrame({points,
                      reinterpret_cast<const std::uint32_t (*)[3]>(s.triangles.data()),
                      s.discontinuity.data(),
                      s.triangles.size(),
                      s.isolated.data(),
                      s.isolated.size(),
                      0.002f,
                      classid.data(),
                      owner.data(),
                      {},
                      nullptr,
                      nullptr,
                      nullptr,
                      nullptr});
  };
  for (const double ahead :
       {0, -1, 1, -2, 2, -3, 3, -4, 4, -6, 6, -8, 8, 12, 16, 24, 32, 48, 64, 80, 96}) {
    const std::size_t k = poses.size();
    surfaces.push_back(build_scan_mesh(sweeps[k], MeshParameters{}));
    frames.push_back(frame_of(k));
    poses.push_back(T_camera_lidar);
    poses.back().translate(Eigen::Vector3d(ahead, 0, 0));
  }
  for (std::size_t k = 0; k < poses.size(); ++k) placed.push_back({&frames[k], poses[k]});
  const double make = median_ms(5, [&] {
    surfaces[0] = build_scan_mesh(sweeps[0], MeshParameters{});
    frame_of(0);
  });
  std::printf("make a surface of %d points and put it in order: %.1f ms\n", int(sweeps[0].rows()),
              make);
  const double slow = median_ms(3, [&] { plain(camera, sweeps, surfaces, poses); });
  std::printf("default, %zu sweeps, plain triangles: %.1f ms\n", poses.size(), slow);
  for (const int threads : {1, 2}) {
    const double fast =
        median_ms(11, [&] { render_meshes(camera, placed, {}, 12, {}, {}, 1, threads); });
    std::printf("default, %d threads: %.1f ms, %.1f times the plain loop\n", threads, fast,
                slow / fast);
  }
}

}  // namespace

int main() {
  keep_memory();
  const Camera camera{721.5, 721.5, 609.6, 172.9, 1242, 375};
  const SplatHeights heights({50, 3});
  constexpr int kSweeps = 100, kPoints = 100032;

  std::vector<Matrix> sweeps;
  std::vector<Cloud> clouds;
  for (int k = 0; k < kSweeps; ++k) sweeps.push_back(street_sweep(kPoints, k));
  const std::vector<std::uint8_t> keep(kPoints, 1);
  const double make = median_ms(5, [&] { clouds.assign(1, Cloud(sweeps[0], keep)); });
  for (int k = 1; k < kSweeps; ++k) clouds.emplace_back(sweeps[k], keep);

  Pose T_camera_lidar = Pose::Identity();
  T_camera_lidar.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  std::vector<PlacedCloud> placed;
  for (int k = 0; k < kSweeps; ++k) {
    Pose T = T_camera_lidar;
    T.translate(Eigen::Vector3d(k, 0, 0));
    placed.push_back({&clouds[k], T, &heights});
  }

  measure_surfaces(camera, sweeps, T_camera_lidar);
  std::printf("make a frame of %d points: %.2f ms\n", kPoints, make);
  std::vector<float> expected, depth;
  const double slow = median_ms(3, [&] { expected = plain(camera, sweeps, placed); });
  std::printf("paper, %.1f M points, plain discs: %.1f ms\n", kSweeps * kPoints / 1e6, slow);
  for (const int threads : {1, 2}) {
    const double fast = median_ms(11, [&] { depth = render_splats(camera, placed, threads); });
    std::printf("paper, %d threads: %.1f ms, %.1f times the plain loop\n", threads, fast,
                slow / fast);
  }
  for (std::size_t i = 0; i < depth.size(); ++i)
    if (depth[i] != expected[i] && !(std::isnan(depth[i]) && std::isinf(expected[i]))) {
      std::printf("pixel %zu differs: %g instead of %g\n", i, depth[i], expected[i]);
      return 1;
    }
}
