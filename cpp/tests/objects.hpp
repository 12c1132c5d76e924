// Objects whose place and motion are known exactly, as sweeps would see them.
#pragma once

#include <cmath>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "docdepth/detections/detections.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/tracking/tracker.hpp"

namespace docdepth::exact {

inline Pose pose_at(double x, double y, double heading = 0) {
  Pose T = Pose::Identity();
  T.translate(Eigen::Vector3d(x, y, 0));
  T.rotate(Eigen::AngleAxisd(heading, Eigen::Vector3d::UnitZ()));
  return T;
}

/// A rectangle from a corner, with samples 0.2 m apart.
inline void add_side(const Pose& T, Eigen::Vector3f corner, Eigen::Vector3f u, Eigen::Vector3f v,
                     Eigen::Vector3f normal, TimedSurface& surface) {
  const Eigen::Isometry3f placed = T.cast<float>();
  const int columns = int(std::lround(u.norm() / 0.2f)), rows = int(std::lround(v.norm() / 0.2f));
  for (int i = 0; i <= columns; ++i)
    for (int j = 0; j <= rows; ++j)
      surface.add(placed * (corner + float(i) / float(columns) * u + float(j) / float(rows) * v),
                  placed.linear() * normal, 0);
}

/// Rear and right side of a box on the ground, the origin in the middle of its bottom.
inline TimedSurface box(const Pose& T, float length = 4.4f, float width = 1.8f,
                        float height = 1.4f) {
  TimedSurface surface;
  const float x = length / 2, y = width / 2;
  add_side(T, {-x, -y, 0.2f}, {0, width, 0}, {0, 0, height}, {-1, 0, 0}, surface);
  add_side(T, {-x, -y, 0.2f}, {length, 0, 0}, {0, 0, height}, {0, -1, 0}, surface);
  return surface;
}

/// A detection of a surface at a range, of whose area so large a share was free.
inline Detection detection(TimedSurface surface, float free, float range = 10,
                           std::uint32_t points = 100) {
  Detection object;
  object.points = points;
  object.area = range * range * float(points);
  object.free_area = free * object.area;
  object.middle = {range, 0, 0};
  object.box = extent_of(surface.points);
  object.ground = {0, 0.05f};
  object.last_occupied = object.stands_until = 1000;
  object.surface = std::move(surface);
  return object;
}

/// Sweeps a tenth of a second apart.
inline std::vector<double> stamps(std::size_t count) {
  std::vector<double> times;
  for (std::size_t k = 0; k < count; ++k) times.push_back(0.1 * double(k));
  return times;
}

inline ReadDetections reader(const std::vector<Detections>& sweeps) {
  return [&sweeps](std::size_t k) { return std::make_shared<const Detections>(sweeps[k]); };
}

}  // namespace docdepth::exact
