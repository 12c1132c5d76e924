// Where the surface of a sweep ends: triangles across depth jumps and between classes, split.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Triangles of one kind, as rows of PartedSurface::vertices.
using Triangles = std::vector<std::array<std::uint32_t, 3>>;

/// A sweep's surface by what it belongs to. A triangle that spans a depth jump, or lies between a
/// moving and a static return, is no surface; the object's edge crosses it somewhere. It is split
/// in the middle as the sensor saw it, and each part continues its own corners at their range.
struct PartedSurface {
  struct Parts {
    Triangles whole;  ///< measured surface
    Triangles split;  ///< what continues it half way over depth jumps
  };
  std::vector<Eigen::Vector3f> vertices;  ///< the points, and behind them those of the split
  Parts fixed, moving;
};

/// @param triangles corners as rows of points
/// @param cut 1 for each triangle across a depth jump
/// @param classid ClassId of every point
PartedSurface part_surface(const Points& points, const std::uint32_t (*triangles)[3],
                           const std::uint8_t* cut, std::size_t count,
                           const std::uint16_t* classid);

}  // namespace docdepth
