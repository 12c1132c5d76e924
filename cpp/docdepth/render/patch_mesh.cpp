#include "docdepth/render/patch_mesh.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "docdepth/geometry/simd.hpp"
#include "docdepth/render/identity.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using TriangleIndices = std::array<std::uint32_t, 3>;

constexpr std::uint32_t kColumns = 64, kRows = 128;  // of cells of direction
constexpr std::uint32_t kPadding = 16;               // see x()

/// Cell of direction of each vertex, column by column.
struct FindCells {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* vertices,
                                  std::uint16_t* __restrict cells) {
    for (std::size_t i = 0; i < count; ++i) {
      const float x = vertices[3 * i], y = vertices[3 * i + 1], z = vertices[3 * i + 2];
      // Diamond angles grow with the angles and need no trigonometry.
      const float sum = std::fabs(x) + std::fabs(y);
      const float part = x / (sum + 1e-30f);
      const float turn = y < 0 ? 3.0f + part : 1.0f - part;
      const float rise = z / (sum + std::fabs(z) + 1e-30f);  // -1 to 1
      const auto column = static_cast<std::int32_t>(turn * (kColumns / 4.0f));
      const auto row = static_cast<std::int32_t>((rise + 1.0f) * (kRows / 2.0f));
      const std::int32_t last_column = kColumns - 1, last_row = kRows - 1;
      // Below 0 only for what is not finite.
      const std::int32_t in_column = column > 0 ? column : 0, in_row = row > 0 ? row : 0;
      cells[i] = static_cast<std::uint16_t>((in_column < last_column ? in_column : last_column) *
                                                std::int32_t{kRows} +
                                            (in_row < last_row ? in_row : last_row));
    }
  }
};

/// Triangles cell after cell, and the end of each column of cells.
struct Order {
  std::vector<std::uint32_t> triangles, column_ends;
};

Order by_direction(const std::vector<std::uint16_t>& cells,
                   const std::vector<TriangleIndices>& triangles) {
  Order order{std::vector<std::uint32_t>(triangles.size()), {}};
  if (triangles.size() <= PatchMesh::kTriangles) {
    std::iota(order.triangles.begin(), order.triangles.end(), 0);
    order.column_ends.push_back(static_cast<std::uint32_t>(triangles.size()));
    return order;
  }
  std::vector<std::uint32_t> start(kColumns * kRows + 1, 0);
  for (const TriangleIndices& corners : triangles) ++start[cells[corners[0]] + 1];
  for (std::size_t c = 1; c < start.size(); ++c) start[c] += start[c - 1];
  for (std::uint32_t c = 1; c <= kColumns; ++c) order.column_ends.push_back(start[c * kRows]);
  for (std::uint32_t t = 0; t < triangles.size(); ++t)
    order.triangles[start[cells[triangles[t][0]]]++] = t;
  return order;
}

}  // namespace

MeshVertices::MeshVertices(const std::vector<Vector>& vertices,
                           const std::vector<std::uint8_t>& classes)
    : vertices_(vertices), classes_(classes), cells_(vertices.size()), place_(vertices.size(), 0) {
  dispatch<FindCells>(vertices.size(), vertices.empty() ? nullptr : vertices[0].data(),
                      cells_.data());
}

PatchMesh::PatchMesh(const std::vector<Vector>& vertices,
                     const std::vector<TriangleIndices>& triangles,
                     const std::vector<std::uint8_t>& classes) {
  MeshVertices all(vertices, classes);
  *this = PatchMesh(all, triangles);
}

PatchMesh::PatchMesh(MeshVertices& vertices, const std::vector<TriangleIndices>& triangles) {
  id_ = new_identity();
  const Order order = by_direction(vertices.cells_, triangles);
  corners_.resize(triangles.size());
  for (auto* axis : {&x_, &y_, &z_}) axis->reserve(triangles.size() + kPadding);
  classes_.reserve(triangles.size());
  Vector low = Vector::Constant(INFINITY), high = -low, patch_low, patch_high;

  const auto close = [&] {
    if (patches_.empty()) return;
    patches_.back().box = Box::around(patch_low, patch_high);
    low = low.cwiseMin(patch_low);
    high = high.cwiseMax(patch_high);
  };
  std::size_t column = 0;
  bool full = true;
  for (std::uint32_t i = 0; i < order.triangles.size(); ++i) {
    for (; i >= order.column_ends[column]; ++column) full = true;
    if (!full) {
      const Patch& patch = patches_.back();
      full = patch.triangles == kTriangles || patch.vertices + 3 > kVertices;
    }
    if (full) {
      close();
      patches_.push_back({{}, std::uint32_t(x_.size()), 0, i, 0});
      ++vertices.patches_;
      patch_low = Vector::Constant(INFINITY);
      patch_high = -patch_low;
      full = false;
    }
    Patch& patch = patches_.back();
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t v = triangles[order.triangles[i]][k];
      std::uint32_t& place = vertices.place_[v];
      if (place / kVertices != vertices.patches_) {
        place = vertices.patches_ * kVertices + patch.vertices++;
        const Vector& p = vertices.vertices_[v];
        x_.push_back(p.x());
        y_.push_back(p.y());
        z_.push_back(p.z());
        classes_.push_back(vertices.classes_.empty() ? 0 : vertices.classes_[v]);
        patch_low = patch_low.cwiseMin(p);
        patch_high = patch_high.cwiseMax(p);
      }
      corners_[i][k] = static_cast<std::uint8_t>(place % kVertices);
    }
    ++patch.triangles;
  }
  close();
  if (!patches_.empty()) box_ = Box::around(low, high);
  for (auto* axis : {&x_, &y_, &z_}) axis->resize(axis->size() + kPadding);
}

}  // namespace docdepth
