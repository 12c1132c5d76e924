// A scan mesh partitioned into the static surface and dynamic objects.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Triangles of one kind, as rows of PartitionedMesh::vertices.
using Triangles = std::vector<std::array<std::uint32_t, 3>>;

/// The mesh of a sweep by surface: the static one, and that of each dynamic object.
///
/// A triangle across a discontinuity or between two surfaces is no measured surface: an edge
/// crosses it somewhere. Such triangles are split. Each side extends the plane at its own corners
/// until it meets the other plane: within an object a little past the middle if it never does, and
/// elsewhere almost to the return of the other side, since rays tell where the surface ends. Of
/// static surface only the nearer side is extrapolated: it may hide the other one.
///
/// Nor is a steep static triangle measured surface if jumps go out from all its corners: among
/// leaves some continue the plane of a neighbour by chance. Seen from elsewhere they are lines over
/// the sky. Where a wall ends one has a corner within the wall.
struct PartitionedMesh {
  struct Parts {
    Triangles whole;  ///< measured surface
    Triangles inner;  ///< extrapolates an object over its own discontinuities
    Triangles
        outer;  ///< extrapolates an object towards other surfaces, static surface over its own
  };
  std::vector<Eigen::Vector3f> vertices;  ///< the points, then the vertices of split triangles
  std::vector<std::uint32_t> sources;     ///< the point whose surface a vertex extrapolates
  std::vector<Parts> parts;               ///< by object_index
  std::vector<Eigen::Vector3f> normals;   ///< at each point, of any length; zero if unknown
};

/// @param triangles      corners as rows of points
/// @param discontinuity  1 for each triangle across a depth jump
/// @param object_index  of every point: 0 the static surface, 1, 2, ... objects
/// @param surfaces       number of objects plus one
/// @param drawn          of object 1, 2, ...: 0 if it is not to be extrapolated; null if all are
PartitionedMesh partition_mesh(const Points& points, const std::uint32_t (*triangles)[3],
                               const std::uint8_t* discontinuity, std::size_t count,
                               const std::uint16_t* object_index, std::size_t surfaces,
                               const std::uint8_t* drawn = nullptr);

}  // namespace docdepth
