// A scan mesh partitioned into the static surface and dynamic objects.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Triangles of one kind, as rows of PartitionedMesh::vertices.
using Triangles = std::vector<std::array<std::uint32_t, 3>>;

/// The mesh of a sweep by owner: the static surface, and each dynamic object.
///
/// A triangle across a discontinuity or between two owners is no measured surface: an edge crosses
/// it somewhere. Such triangles are split. Each side continues the plane at its own corners until
/// it meets the other plane: within an object a little past the middle if it never does, and
/// elsewhere almost to the return of the other side, since rays tell where the surface ends. Of
/// static surface only the nearer side is continued: it may hide the other one.
struct PartitionedMesh {
  struct Parts {
    Triangles whole;  ///< measured surface
    Triangles inner;  ///< continues an object over its own discontinuities
    Triangles outer;  ///< continues an object towards other owners, static surface over its own
  };
  std::vector<Eigen::Vector3f> vertices;  ///< the points, then the vertices of split triangles
  std::vector<std::uint32_t> sources;     ///< the point whose surface a vertex continues
  std::vector<Parts> parts;               ///< by owner
  std::vector<Eigen::Vector3f> normals;   ///< at each point, of any length; zero if unknown
};

/// @param triangles      corners as rows of points
/// @param discontinuity  1 for each triangle across a depth jump
/// @param owner          of every point: 0 the static surface, 1, 2, ... objects
/// @param owners         number of objects plus one
/// @param drawn          of object 1, 2, ...: 0 if it is not to be continued; null if all are
PartitionedMesh partition_mesh(const Points& points, const std::uint32_t (*triangles)[3],
                               const std::uint8_t* discontinuity, std::size_t count,
                               const std::uint16_t* owner, std::size_t owners,
                               const std::uint8_t* drawn = nullptr);

}  // namespace docdepth
