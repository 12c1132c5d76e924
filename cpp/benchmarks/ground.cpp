// Nanoseconds of ground growing an input point, and how many times faster than one hash of voxels,
// a k-d tree of nanoflann over all of them and an eigensolver for every front point.
//
//   benchmark_ground [threads [DRIVE [frames]]]
//
// DRIVE is a folder of a KITTI raw drive with lidar_poses_tum.txt (t x y z qx qy qz qw); without it
// a made-up street is driven.
#include "docdepth/ground/ground.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <nanoflann.hpp>
#include <random>
#include <string>
#include <unordered_map>
#include <vector>

#include "docdepth/ground/octree.hpp"

using namespace docdepth;
using Eigen::Vector3d;

namespace {

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

struct Drive {
  std::vector<Matrix> sweeps;
  std::vector<Pose> poses;

  std::size_t points() const {
    std::size_t count = 0;
    for (const Matrix& sweep : sweeps) count += sweep.rows();
    return count;
  }
};

/// 64 rings over a road between kerbs and facades, a metre a sweep.
Drive street_drive(int frames) {
  Drive drive;
  std::mt19937 random(1);
  std::normal_distribution<double> noise(0.0, 0.01);
  for (int frame = 0; frame < frames; ++frame) {
    Matrix points(64 * 1800, 3);
    for (Eigen::Index i = 0; i < points.rows(); ++i) {
      const double azimuth = 2 * M_PI * (i / 64) / 1800;
      const double elevation = (2.0 - 26.8 * (i % 64) / 63.0) * M_PI / 180;
      const Vector3d u(std::cos(elevation) * std::cos(azimuth),
                       std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
      double range = 80.0 / std::max(1e-9, std::abs(u.x()));
      range = std::min(range, 9.0 / std::max(1e-9, std::abs(u.y())));
      if (u.z() < 0) {
        const double road = -1.73 / u.z();
        range = std::min(range, std::abs(road * u.y()) < 5.0 ? road : -1.58 / u.z());
      }
      points.row(i) = ((range + noise(random)) * u).cast<float>();
    }
    Pose pose = Pose::Identity();
    pose.translation() = Vector3d(1.0 * frame, 0.3 * std::sin(0.1 * frame), 0.0);
    drive.sweeps.push_back(points);
    drive.poses.push_back(pose);
  }
  return drive;
}

Drive kitti_drive(const std::string& folder, int frames) {
  Drive drive;
  std::ifstream poses(folder + "/lidar_poses_tum.txt");
  double t, x, y, z, qx, qy, qz, qw;
  for (int frame = 0; frame < frames && poses >> t >> x >> y >> z >> qx >> qy >> qz >> qw;
       ++frame) {
    char name[64];
    std::snprintf(name, sizeof name, "/velodyne_points/data/%010d.bin", frame);
    std::ifstream file(folder + name, std::ios::binary | std::ios::ate);
    const auto bytes = static_cast<std::size_t>(file.tellg());
    Eigen::Matrix<float, Eigen::Dynamic, 4, Eigen::RowMajor> rows(bytes / 16, 4);
    file.seekg(0).read(reinterpret_cast<char*>(rows.data()), rows.size() * 4);
    Pose pose = Pose::Identity();
    pose.translation() = Vector3d(x, y, z);
    pose.linear() = Eigen::Quaterniond(qw, qx, qy, qz).normalized().toRotationMatrix();
    drive.sweeps.emplace_back(rows.leftCols<3>());
    drive.poses.push_back(pose);
  }
  return drive;
}

/// The plain reference: the same labels, coded as the paper tells it.
class PlainGround {
 public:
  explicit PlainGround(const GroundParameters& parameters) : parameters_(parameters) {}

  void insert(const Points& points, const Pose& pose) {
    if (positions_.empty()) origin_ = pose.translation();
    positions_.push_back(pose.translation() - origin_);
    const VoxelGrid grid(pose, origin_, parameters_.voxel_size);
    for (Eigen::Index i = 0; i < points.rows(); ++i) {
      const Vector3d p = grid * (points.data() + 3 * i);
      const auto [voxel, is_new] = voxels_.try_emplace(key(grid, p), sums_.size());
      if (is_new) {
        sums_.push_back(p);
        counts_.push_back(1);
      } else {
        sums_[voxel->second] += p;
        ++counts_[voxel->second];
      }
    }
  }

  std::size_t grow() {
    for (std::size_t i = 0; i < sums_.size(); ++i) cloud_.points.push_back(sums_[i] / counts_[i]);
    ground_.assign(sums_.size(), false);
    const Tree tree(3, cloud_, nanoflann::KDTreeSingleIndexAdaptorParams(16));
    std::vector<std::size_t> front;
    std::size_t count = 0;
    const auto reach = [&](std::size_t i) {
      if (!ground_[i]) {
        front.push_back(i);
        ++count;
      }
      ground_[i] = true;
    };
    for (const Vector3d& position : positions_) reach(seed(position));
    const std::vector<bool> seeds = ground_;
    const auto k = std::min<std::size_t>(parameters_.neighbors, sums_.size());
    std::vector<std::size_t> near(k);
    std::vector<double> distances(k);
    while (!front.empty()) {
      const std::size_t i = front.back();
      front.pop_back();
      tree.knnSearch(cloud_.points[i].data(), k, near.data(), distances.data());
      Vector3d mean = Vector3d::Zero();
      for (const auto n : near) mean += cloud_.points[n] - cloud_.points[i];
      mean = cloud_.points[i] + mean / static_cast<double>(k);
      Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
      for (const auto n : near)
        covariance += (cloud_.points[n] - mean) * (cloud_.points[n] - mean).transpose();
      const Vector3d normal =
          Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(covariance).eigenvectors().col(0);
      if (std::abs(normal.z()) < std::cos(parameters_.max_slope)) continue;
      const Vector3d on_plane = seeds[i] ? mean : cloud_.points[i];
      for (const auto n : near)
        if (std::abs(normal.dot(cloud_.points[n] - on_plane)) < parameters_.plane_distance)
          reach(n);
    }
    return count;
  }

  void label(const Points& points, const Pose& pose, bool* ground) const {
    const VoxelGrid grid(pose, origin_, parameters_.voxel_size);
    for (Eigen::Index i = 0; i < points.rows(); ++i)
      ground[i] = ground_[voxels_.find(key(grid, grid * (points.data() + 3 * i)))->second];
  }

 private:
  struct Cloud {
    std::vector<Vector3d> points;
    std::size_t kdtree_get_point_count() const { return points.size(); }
    double kdtree_get_pt(std::size_t i, std::size_t axis) const { return points[i][axis]; }
    template <class Box>
    bool kdtree_get_bbox(Box&) const {
      return false;
    }
  };
  using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, Cloud>,
                                                   Cloud, 3, std::size_t>;

  static std::uint64_t key(const VoxelGrid& grid, const Vector3d& p) {
    const VoxelAddress address = grid.address(p);
    return address.key << 6 | address.bit;
  }

  std::size_t seed(const Vector3d& position) const {
    for (double radius = parameters_.seed_radius;; radius *= 2.0) {
      std::vector<std::size_t> inside;
      for (std::size_t i = 0; i < sums_.size(); ++i) {
        const Vector3d& p = cloud_.points[i];
        const double dx = p.x() - position.x(), dy = p.y() - position.y();
        if (dx * dx + dy * dy > radius * radius) continue;
        inside.push_back(i);
      }
      if (inside.empty()) continue;
      const auto chosen =
          inside.begin() + std::ptrdiff_t(parameters_.seed_quantile * double(inside.size() - 1));
      std::nth_element(inside.begin(), chosen, inside.end(), [&](std::size_t a, std::size_t b) {
        return cloud_.points[a].z() < cloud_.points[b].z();
      });
      return *chosen;
    }
  }

  GroundParameters parameters_;
  Vector3d origin_ = Vector3d::Zero();
  std::vector<Vector3d> positions_, sums_;
  std::vector<int> counts_;
  std::unordered_map<std::uint64_t, std::size_t> voxels_;
  Cloud cloud_;
  std::vector<bool> ground_;
};

using Seconds = std::array<double, 3>;  // insert, grow, label

template <class Ground>
Seconds drive_once(Ground&& ground, const Drive& drive, std::vector<std::vector<char>>& labels) {
  const auto now = [] { return std::chrono::steady_clock::now(); };
  const auto seconds = [](auto from, auto to) {
    return std::chrono::duration<double>(to - from).count();
  };
  const auto start = now();
  for (std::size_t i = 0; i < drive.sweeps.size(); ++i)
    ground.insert(drive.sweeps[i], drive.poses[i]);
  const auto inserted = now();
  ground.grow();
  const auto grown = now();
  labels.resize(drive.sweeps.size());
  for (std::size_t i = 0; i < drive.sweeps.size(); ++i) {
    labels[i].resize(drive.sweeps[i].rows());
    ground.label(drive.sweeps[i], drive.poses[i], reinterpret_cast<bool*>(labels[i].data()));
  }
  return {seconds(start, inserted), seconds(inserted, grown), seconds(grown, now())};
}

void print(const char* name, const Seconds& seconds, std::size_t points) {
  std::printf("%-10s insert %6.2f s  grow %6.2f s  label %6.2f s  together %7.1f ns a point\n",
              name, seconds[0], seconds[1], seconds[2],
              1e9 * (seconds[0] + seconds[1] + seconds[2]) / static_cast<double>(points));
}

}  // namespace

int main(int argc, char** argv) {
  const int threads = argc > 1 ? std::atoi(argv[1]) : 2;
  const int frames = argc > 3 ? std::atoi(argv[3]) : argc > 2 ? 100 : 30;
  const Drive drive = argc > 2 ? kitti_drive(argv[2], frames) : street_drive(frames);
  GroundParameters parameters;
  std::printf("%zu sweeps, %zu points, s = %g m, %d threads\n", drive.sweeps.size(), drive.points(),
              parameters.voxel_size, threads);
  std::vector<std::vector<char>> labels, expected;
  const auto total = [](const Seconds& s) { return s[0] + s[1] + s[2]; };
  const auto median = [&] {
    std::vector<Seconds> runs;
    for (int run = 0; run < 3; ++run)
      runs.push_back(drive_once(GroundMap(parameters, threads), drive, labels));
    std::sort(runs.begin(), runs.end(),
              [&](const Seconds& a, const Seconds& b) { return total(a) < total(b); });
    return runs[1];
  };
  print("docdepth", median(), drive.points());
  parameters.step_height = 0;  // the plain version does not go on behind kerbs
  const Seconds ours = median();
  print("no steps", ours, drive.points());

  const Seconds plain = drive_once(PlainGround(parameters), drive, expected);
  print("plain", plain, drive.points());
  std::printf("%.1f times faster, labels %s\n", total(plain) / total(ours),
              labels == expected ? "equal" : "DIFFER");
  return labels == expected ? 0 : 1;
}
