// Triangles of one sweep, put in order once so that what the camera cannot see costs nothing.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"

namespace docdepth {

constexpr std::uint8_t kNoClass = 255;  ///< of places that are no return

/// Vertices that meshes are made of, and what one leaves for the next, so that a hundred small ones
/// cost little.
class MeshVertices {
 public:
  /// Both must live as long.
  /// @param classes a byte a vertex that is kept with it, or empty for 0
  MeshVertices(const std::vector<Eigen::Vector3f>& vertices,
               const std::vector<std::uint8_t>& classes);

 private:
  friend class Mesh;
  const std::vector<Eigen::Vector3f>& vertices_;
  const std::vector<std::uint8_t>& classes_;
  std::vector<std::uint16_t> cells_;  // of direction, of each vertex
  std::vector<std::uint32_t> place_;  // of each vertex: last patch with it, number within that
  std::uint32_t patches_ = 0;         // made so far
};

/// Triangles in patches of neighbours, each with its own vertices and box. A vertex on the border
/// of two patches is kept twice, which costs less than looking it up elsewhere.
class Mesh {
 public:
  static constexpr std::uint32_t kVertices = 256;   ///< most vertices of a patch
  static constexpr std::uint32_t kTriangles = 256;  ///< most triangles of a patch

  struct Patch {
    Box box;
    std::uint32_t vertex, vertices;     ///< first and number
    std::uint32_t triangle, triangles;  ///< first and number
  };
  /// Numbers of corners within a patch.
  using Corners = std::array<std::uint8_t, 3>;

  Mesh() = default;

  /// @param triangles corners as rows of `vertices`; vertices without a triangle are left out
  Mesh(MeshVertices& vertices, const std::vector<std::array<std::uint32_t, 3>>& triangles);
  Mesh(const std::vector<Eigen::Vector3f>& vertices,
       const std::vector<std::array<std::uint32_t, 3>>& triangles,
       const std::vector<std::uint8_t>& classes = {});

  std::size_t size() const { return corners_.size(); }
  std::size_t vertex_count() const {
    return patches_.empty() ? 0 : patches_.back().vertex + patches_.back().vertices;
  }
  std::uint64_t id() const { return id_; }  ///< see new_identity()
  const Box& box() const { return box_; }
  const std::vector<Patch>& patches() const { return patches_; }
  const Corners* corners() const { return corners_.data(); }
  /// Readable kPadding numbers behind the last vertex.
  const float* x() const { return x_.data(); }
  const float* y() const { return y_.data(); }
  const float* z() const { return z_.data(); }
  const std::uint8_t* classes() const { return classes_.data(); }

 private:
  std::uint64_t id_ = 0;
  Box box_{};
  std::vector<Patch> patches_;
  std::vector<Corners> corners_;
  std::vector<float> x_, y_, z_;
  std::vector<std::uint8_t> classes_;
};

}  // namespace docdepth
