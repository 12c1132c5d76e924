#include "docdepth/render/mesh.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/render/identity.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Triangle = std::array<std::uint32_t, 3>;

constexpr std::uint32_t kColumns = 256, kRows = 64, kPadding = 16;

/// Which of the cells of direction around the sensor, column by column.
std::uint32_t cell(const Vector& p) {
  const float sum = std::abs(p.x()) + std::abs(p.y());
  // Diamond angles grow with the angles themselves and need no trigonometry.
  float turn = sum > 0 ? p.x() / sum : 0.0f;
  turn = p.y() < 0 ? 3.0f + turn : 1.0f - turn;
  const float rise = p.z() / (sum + std::abs(p.z()) + 1e-6f);  // -1 to 1
  const auto column = std::min(static_cast<std::uint32_t>(turn * (kColumns / 4.0f)), kColumns - 1);
  const auto row = std::min(static_cast<std::uint32_t>((rise + 1.0f) * (kRows / 2.0f)), kRows - 1);
  return column * kRows + row;
}

/// Numbers of the triangles, cell after cell, and where each column of cells ends.
struct Order {
  std::vector<std::uint32_t> triangles, column_ends;
};

Order by_direction(const std::vector<Vector>& vertices, const std::vector<Triangle>& triangles) {
  std::vector<std::uint32_t> cells(triangles.size()), start(kColumns * kRows + 1, 0);
  for (std::size_t t = 0; t < triangles.size(); ++t) {
    const auto& [a, b, c] = triangles[t];
    cells[t] = cell(vertices[a] + vertices[b] + vertices[c]);
    ++start[cells[t] + 1];
  }
  for (std::size_t c = 1; c < start.size(); ++c) start[c] += start[c - 1];
  Order order{std::vector<std::uint32_t>(triangles.size()), {}};
  for (std::uint32_t c = 1; c <= kColumns; ++c) order.column_ends.push_back(start[c * kRows]);
  for (std::uint32_t t = 0; t < triangles.size(); ++t) order.triangles[start[cells[t]]++] = t;
  return order;
}

Box box_around(const Vector& low, const Vector& high) {
  return {(low + high) / 2, (high - low) / 2 + Vector::Constant(1e-3f)};
}

}  // namespace

Mesh::Mesh(const std::vector<Vector>& vertices, const std::vector<Triangle>& triangles,
           const std::vector<std::uint8_t>& classes) {
  id_ = new_identity();
  const Order order = by_direction(vertices, triangles);
  corners_.reserve(triangles.size());
  std::vector<std::uint32_t> patch_of(vertices.size(), ~0u);
  std::vector<std::uint8_t> local(vertices.size());
  Vector low = Vector::Constant(INFINITY), high = -low, patch_low, patch_high;

  const auto close = [&] {
    if (patches_.empty()) return;
    patches_.back().box = box_around(patch_low, patch_high);
    low = low.cwiseMin(patch_low), high = high.cwiseMax(patch_high);
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
      patches_.push_back({{}, std::uint32_t(x_.size()), 0, std::uint32_t(corners_.size()), 0});
      patch_low = Vector::Constant(INFINITY), patch_high = -patch_low;
      full = false;
    }
    Patch& patch = patches_.back();
    Corners corners;
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t v = triangles[order.triangles[i]][k];
      if (patch_of[v] != patches_.size()) {
        patch_of[v] = static_cast<std::uint32_t>(patches_.size());
        local[v] = static_cast<std::uint8_t>(patch.vertices++);
        const Vector& p = vertices[v];
        x_.push_back(p.x()), y_.push_back(p.y()), z_.push_back(p.z());
        classes_.push_back(classes.empty() ? 0 : classes[v]);
        patch_low = patch_low.cwiseMin(p), patch_high = patch_high.cwiseMax(p);
      }
      corners[k] = local[v];
    }
    corners_.push_back(corners);
    ++patch.triangles;
  }
  close();
  if (!patches_.empty()) box_ = box_around(low, high);
  for (auto* axis : {&x_, &y_, &z_}) axis->resize(axis->size() + kPadding);
}

}  // namespace docdepth
