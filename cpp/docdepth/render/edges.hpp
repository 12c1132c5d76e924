// Where the surface of a sweep ends: triangles across depth jumps and between classes, split.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Triangles of one kind, as rows of PartedSurface::vertices.
using Triangles = std::vector<std::array<std::uint32_t, 3>>;

/// A sweep's surface by what it belongs to: the world, and each moving object. A triangle that
/// spans a depth jump, or lies between the returns of two, is no surface; an edge crosses it
/// somewhere. Of the world other sweeps know where. What moves they saw elsewhere: there the
/// triangle is split, and its part goes on with the plane of the surface at its own corners, to
/// where that meets the other plane if it does on the way, else a little past the middle as the
/// sensor saw it.
struct PartedSurface {
  struct Parts {
    Triangles whole;  ///< measured surface
    Triangles inner;  ///< what continues it over depth jumps of its own; none of the world
    Triangles outer;  ///< what continues it towards others; none of the world
  };
  std::vector<Eigen::Vector3f> vertices;  ///< the points, and behind them those of the split
  std::vector<Parts> parts;               ///< by owner
  /// Of the whole surface at each point, of any length; zero where there is none.
  std::vector<Eigen::Vector3f> normals;
};

/// @param triangles corners as rows of points
/// @param cut 1 for each triangle across a depth jump
/// @param owner of every point: 0 the world, 1, 2, ... objects
/// @param owners number of objects, and one
PartedSurface part_surface(const Points& points, const std::uint32_t (*triangles)[3],
                           const std::uint8_t* cut, std::size_t count,
                           const std::vector<std::uint32_t>& owner, std::size_t owners);

}  // namespace docdepth
