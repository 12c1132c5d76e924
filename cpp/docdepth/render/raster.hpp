// Rasterising triangles, for depth maps and for their layers.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "docdepth/geometry/rigid.hpp"
#include "docdepth/geometry/simd.hpp"
#include "docdepth/render/camera.hpp"
#include "docdepth/render/depth_hypotheses.hpp"
#include "docdepth/render/triangles.hpp"

// The image is cut into strips of columns. One thread draws all meshes into a strip, so nothing is
// shared and the order within a strip never changes.
namespace docdepth {

constexpr int kStrip = DepthHypotheses::kStrip;  // 375 rows of them fit the first cache levels

/// Inverse depth, which is linear on the image of a plane, of columns [begin, end); 0 is empty.
struct Strip {
  int begin, end, height;
  std::vector<float> inverse_depth;      // kStride values a row
  std::vector<std::uint8_t> open_tiles;  // 0 where nothing has to be drawn
  std::vector<std::int32_t>
      numbers;  // of the triangles, laid out like inverse_depth; empty for depth maps

  static constexpr int kStride = kStrip + kLanes, kTile = DepthHypotheses::kTile,
                       kTiles = kStride / kTile;
  Strip(int b, int e, int h)
      : begin(b),
        end(e),
        height(h),
        inverse_depth(std::size_t(kStride) * h, 0.0f),
        open_tiles(std::size_t(kTiles) * ((h + kTile - 1) / kTile), 1) {}

  /// Empty the strip, and draw only in the open tiles from now on.
  void open_only(const DepthHypotheses& hypotheses) {
    std::fill(inverse_depth.begin(), inverse_depth.end(), 0.0f);
    const auto& open = hypotheses.open_tiles();
    for (std::size_t tile = 0; tile < open.size(); ++tile)
      open_tiles[tile / hypotheses.tiles() * kTiles + tile % hypotheses.tiles()] = open[tile];
  }

  bool is_open(int first_u, int last_u, int first_v, int last_v) const {
    for (int v = first_v / kTile; v <= last_v / kTile; ++v)
      for (int u = (first_u - begin) / kTile; u <= (last_u - begin) / kTile; ++u)
        if (open_tiles[v * kTiles + u]) return true;
    return false;
  }
};

/// Vertices of a patch in the image.
struct Projected {
  alignas(32) float u[PatchMesh::kVertices + kLanes], v[PatchMesh::kVertices + kLanes],
      w[PatchMesh::kVertices + kLanes];  // 1 / depth; 0 if nearer than kNear
  alignas(32) std::int32_t outside[PatchMesh::kVertices + kLanes];
};

/// Sides of the strip beyond which a vertex lies. A triangle is not visible if all its corners lie
/// beyond one side, or one lies behind the camera.
constexpr std::int32_t kLeft = 1, kRight = 2, kAbove = 4, kBelow = 8, kBehind = 16;

/// Vertices this deep are left out [m]: they are not measurements, and infinity times the inverse
/// of infinity would be a pixel that is no number.
constexpr float kBeyond = 1e18f;

/// Project a patch. @return false if nothing of it falls on open tiles.
DOCDEPTH_KERNEL bool project_patch(const PatchMesh& mesh, const PatchMesh::Patch& patch,
                                   const RigidTransform& T, const Camera& camera,
                                   const Strip& strip, Projected& out) {
  const auto fx = float(camera.fx), fy = float(camera.fy), cx = float(camera.cx),
             cy = float(camera.cy);
  const auto left = float(strip.begin), right = float(strip.end - 1);
  const auto bottom = float(strip.height - 1);
  Floats low_u = Floats{} + INFINITY, high_u = -low_u, low_v = low_u, high_v = -low_u;
  for (std::uint32_t i = 0; i < patch.vertices; i += kLanes) {
    const std::uint32_t at = patch.vertex + i;
    const auto [x, y, z] = moved(T, mesh.x() + at, mesh.y() + at, mesh.z() + at);
    const Ints seen = (z > kNear) & (z < kBeyond);
    const Floats w = 1.0f / z;
    const Floats u = (fx * x) * w + cx, v = (fy * y) * w + cy;
    const Floats shown = seen ? w : Floats{};
    const Ints outside = ((u + kSlack < left) & kLeft) | ((u - kSlack > right) & kRight) |
                         ((v + kSlack < 0.0f) & kAbove) | ((v - kSlack > bottom) & kBelow) |
                         (~seen & kBehind);
    store(u, out.u + i);
    store(v, out.v + i);
    store(shown, out.w + i);
    store(outside, out.outside + i);
    const Ints part =
        seen & (Ints{0, 1, 2, 3, 4, 5, 6, 7} + std::int32_t(i) < std::int32_t(patch.vertices));
    low_u = part & (u < low_u) ? u : low_u;
    high_u = part & (u > high_u) ? u : high_u;
    low_v = part & (v < low_v) ? v : low_v;
    high_v = part & (v > high_v) ? v : high_v;
  }
  const auto least = [](const Floats& lanes) {
    float low = lanes[0];
    for (int lane = 1; lane < kLanes; ++lane) low = std::min(low, lanes[lane]);
    return low;
  };
  const float first_u = std::max(least(low_u) - 1, left);
  const float last_u = std::min(1 - least(-high_u), right);
  const float first_v = std::max(least(low_v) - 1, 0.0f);
  const float last_v = std::min(1 - least(-high_v), bottom);
  return first_u <= last_u && first_v <= last_v &&
         strip.is_open(int(first_u), int(last_u), int(first_v), int(last_v));
}

/// An edge of a triangle. Its value is not negative inside the triangle.
struct Edge {
  float u, v, du, dv, slack;
};

DOCDEPTH_KERNEL Edge edge(float u0, float v0, float u1, float v1, float turn) {
  const float du = (u1 - u0) * turn, dv = (v1 - v0) * turn;
  return {u0, v0, du, dv, kSlack * (std::fabs(du) + std::fabs(dv))};
}

/// Keep the inverse depth of eight pixels where they are inside a triangle and nearer than before.
template <bool kNumbered>
DOCDEPTH_KERNEL void keep_nearer(Strip& strip, std::size_t pixel, const Ints& inside,
                                 const Floats& w, std::int32_t number) {
  float* cell = strip.inverse_depth.data() + pixel;
  const Floats old = load(cell);
  const Ints nearer = inside & (w > old);
  store(nearer ? w : old, cell);
  if constexpr (kNumbered) {
    std::int32_t* numbers = strip.numbers.data() + pixel;
    store(nearer ? Ints{} + number : load<Ints>(numbers), numbers);
  }
}

/// No corner is behind the camera, and not all are outside the strip on one side.
///
/// @tparam kNumbered also keeps the number of the triangle
template <bool kNumbered>
DOCDEPTH_KERNEL void draw_triangle(const Projected& p, const PatchMesh::Corners& corners,
                                   std::int32_t number, Strip& strip) {
  const int a = corners[0], b = corners[1], c = corners[2];
  const float wa = p.w[a], wb = p.w[b], wc = p.w[c];
  const float low_w = std::min(wa, std::min(wb, wc)), high_w = std::max(wa, std::max(wb, wc));
  const float ua = p.u[a], ub = p.u[b], uc = p.u[c], va = p.v[a], vb = p.v[b], vc = p.v[c];
  const float low_u = std::max(std::min(ua, std::min(ub, uc)) - kSlack, float(strip.begin));
  const float high_u = std::min(std::max(ua, std::max(ub, uc)) + kSlack, float(strip.end - 1));
  const float low_v = std::max(std::min(va, std::min(vb, vc)) - kSlack, 0.0f);
  const float high_v = std::min(std::max(va, std::max(vb, vc)) + kSlack, float(strip.height - 1));
  const int first_u = int(std::ceil(low_u)), last_u = int(high_u);
  const int first_v = int(std::ceil(low_v)), last_v = int(high_v);
  if (first_u > last_u || first_v > last_v) return;
  if (!strip.is_open(first_u, last_u, first_v, last_v)) return;

  const float area = (ub - ua) * (vc - va) - (uc - ua) * (vb - va);
  if (area == 0) return;
  const float turn = area > 0 ? 1.0f : -1.0f, inverse = 1.0f / area;
  const Edge e0 = edge(ua, va, ub, vb, turn), e1 = edge(ub, vb, uc, vc, turn),
             e2 = edge(uc, vc, ua, va, turn);
  const float slope_u = ((wb - wa) * (vc - va) - (wc - wa) * (vb - va)) * inverse;
  const float slope_v = ((wc - wa) * (ub - ua) - (wb - wa) * (uc - ua)) * inverse;

  const Floats lanes = {0, 1, 2, 3, 4, 5, 6, 7};
  for (int u = first_u; u <= last_u; u += kLanes) {
    const Floats column = lanes + float(u);
    const Ints within = column <= high_u;
    const Floats at0 = e0.slack - (column - e0.u) * e0.dv, at1 = e1.slack - (column - e1.u) * e1.dv,
                 at2 = e2.slack - (column - e2.u) * e2.dv, w_column = (column - ua) * slope_u + wa;
    for (int v = first_v; v <= last_v; ++v) {
      const auto row = float(v);
      const Ints inside = within & ((row - e0.v) * e0.du + at0 >= 0.0f) &
                          ((row - e1.v) * e1.du + at1 >= 0.0f) &
                          ((row - e2.v) * e2.du + at2 >= 0.0f);
      Floats w = (row - va) * slope_v + w_column;
      w = w < low_w ? Floats{} + low_w : w;
      w = w > high_w ? Floats{} + high_w : w;
      keep_nearer<kNumbered>(strip, std::size_t(v) * Strip::kStride + (u - strip.begin), inside, w,
                             number);
    }
  }
}

/// Draw a mesh. @return false if nothing of it is visible.
template <bool kNumbered = false>
DOCDEPTH_KERNEL bool draw_mesh(const Camera& camera, const PlacedMesh& placed, Strip& strip) {
  const PatchMesh& mesh = *placed.mesh;
  Camera part = camera;  // that sees only the columns of the strip
  part.cx -= strip.begin;
  part.width = strip.end - strip.begin;
  const Frustum frustum(part, placed.T_camera_mesh);
  if (!mesh.size() || !frustum.touches(mesh.box())) return false;
  const RigidTransform T(placed.T_camera_mesh);
  Projected points;
  for (const PatchMesh::Patch& patch : mesh.patches()) {
    if (!frustum.touches(patch.box)) continue;
    if (!project_patch(mesh, patch, T, camera, strip, points)) continue;
    for (std::uint32_t t = patch.triangle; t < patch.triangle + patch.triangles; ++t) {
      const auto& [i, j, k] = mesh.corners()[t];
      const std::int32_t a = points.outside[i], b = points.outside[j], c = points.outside[k];
      if ((a & b & c) || ((a | b | c) & kBehind)) continue;
      draw_triangle<kNumbered>(points, mesh.corners()[t], static_cast<std::int32_t>(t), strip);
    }
  }
  return true;
}

}  // namespace docdepth
