// The triangles of a sweep in patches of neighbours, so that patches outside the view are skipped.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"

namespace docdepth {

/// The vertices of several meshes, with scratch memory that they share: a hundred small meshes cost
/// little.
class MeshVertices {
 public:
  /// Both arguments must outlive this.
  /// @param classes  ClassId of each vertex; empty for ground
  MeshVertices(const std::vector<Eigen::Vector3f>& vertices,
               const std::vector<std::uint8_t>& classes);

 private:
  friend class PatchMesh;
  const std::vector<Eigen::Vector3f>& vertices_;
  const std::vector<std::uint8_t>& classes_;
  std::vector<std::uint16_t> cells_;  // cell of direction of each vertex
  std::vector<std::uint32_t> place_;  // of each vertex: last patch with it, number in that
  std::uint32_t patches_ = 0;         // made so far
};

/// Triangles in patches of neighbours, each with its own vertices and box. A vertex between two
/// patches is kept twice, which costs less than looking it up.
class PatchMesh {
 public:
  static constexpr std::uint32_t kVertices = 256;   ///< most vertices of a patch
  static constexpr std::uint32_t kTriangles = 256;  ///< most triangles of a patch

  struct Patch {
    Box box;
    std::uint32_t vertex, vertices;     ///< first and number
    std::uint32_t triangle, triangles;  ///< first and number
  };
  /// Corners as numbers of vertices within a patch.
  using Corners = std::array<std::uint8_t, 3>;

  PatchMesh() = default;

  /// @param triangles  corners as rows of `vertices`; vertices without a triangle are left out
  PatchMesh(MeshVertices& vertices, const std::vector<std::array<std::uint32_t, 3>>& triangles);
  PatchMesh(const std::vector<Eigen::Vector3f>& vertices,
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
  /// Up to 16 values may be read behind the last vertex.
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
