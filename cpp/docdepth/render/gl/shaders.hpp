// The shaders of GlRenderer. They round like splats.cpp and raster.hpp.
#pragma once

namespace docdepth::gl {

/// Largest height of a splat [pixel]: `limits` has one more entry.
constexpr int kLargestSplat = 511;

/// The start of every shader. `precise` forbids fused operations.
constexpr const char* kExact = R"(#version 330 core
#extension GL_ARB_gpu_shader5 : enable
#ifdef GL_ARB_gpu_shader5
#define EXACT precise
#else
#define EXACT
#endif
uniform vec4 rows[3];  // of T_camera_points
uniform vec4 lens;     // fx, fy, cx, cy
uniform vec2 size;     // of the image

float high_bits(float a) { return intBitsToFloat(floatBitsToInt(a) & ~0xfff); }

// a / b rounded as IEEE 754 says. GLSL's quotient may be off by a few units in the last place. Its
// exact remainder, from products of halves (Dekker 1971), corrects it.
float divide(float a, float b) {
  EXACT float q = a / b;
  EXACT float q1 = high_bits(q), b1 = high_bits(b);
  EXACT float q2 = q - q1, b2 = b - b1;
  EXACT float remainder = ((a - q1 * b1) - q1 * b2 - q2 * b1) - q2 * b2;
  EXACT float rounded = q + remainder / b;
  return rounded;
}

// Rounds like RigidTransform.
float row(vec4 r, vec3 p) {
  EXACT float moved = ((r.x * p.x + r.y * p.y) + r.z * p.z) + r.w;
  return moved;
}
vec3 move(vec3 p) { return vec3(row(rows[0], p), row(rows[1], p), row(rows[2], p)); }
)";

/// The pixel of a point, the height of its splat, which is -1 where nothing is drawn, and its
/// depth.
constexpr const char* kSplatVertex = R"(
layout(location = 0) in float x;
layout(location = 1) in float y;
layout(location = 2) in float z;
uniform float limits[512];  // largest squared distance at which a height is reached
uniform int largest;
out vec4 centre;            // column, row, height, depth

float height(float squared) {
  int reached = 0, missed = largest + 1;
  while (missed - reached > 1) {
    int middle = (reached + missed) / 2;
    if (squared <= limits[middle]) reached = middle; else missed = middle;
  }
  return float(reached);
}

void main() {
  vec3 p = move(vec3(x, y, z));
  EXACT float fx_x = lens.x * p.x, fy_y = lens.y * p.y;
  EXACT float u = (divide(fx_x, p.z) + lens.z) + 0.5;
  EXACT float v = (divide(fy_y, p.z) + lens.w) + 0.5;
  EXACT float squared = (p.x * p.x + p.y * p.y) + p.z * p.z;
  bool drawn = p.z > 0.1 && u >= 0.0 && u < size.x && v >= 0.0 && v < size.y;
  centre = vec4(floor(u), floor(v), drawn ? height(squared) : -1.0, p.z);
}
)";

/// A splat becomes the square of pixels around it, and the fragments test its edge.
constexpr const char* kSplatGeometry = R"(
layout(points) in;
layout(triangle_strip, max_vertices = 4) out;
in vec4 centre[];
flat out vec4 splat;

void main() {
  if (centre[0].z < 0.0) return;
  float half_edge = floor(centre[0].z / 2.0) + 0.5;
  for (int i = 0; i < 4; ++i) {
    splat = centre[0];
    vec2 at = centre[0].xy + 0.5 + (vec2(i & 1, i >> 1) * 2.0 - 1.0) * half_edge;
    gl_Position = vec4(at / size * 2.0 - 1.0, 0.0, 1.0);
    EmitVertex();
  }
}
)";

constexpr const char* kSplatFragment = R"(
flat in vec4 splat;
out float nearest;
void main() {
  ivec2 d = ivec2(gl_FragCoord.xy) - ivec2(splat.xy);
  int height = int(splat.z);
  if (9 * d.x * d.x + 4 * d.y * d.y > height * height) discard;
  nearest = splat.w;
}
)";

constexpr const char* kTriangleVertex = R"(
layout(location = 0) in float x;
layout(location = 1) in float y;
layout(location = 2) in float z;
out vec3 corner;  // column, row, inverse_depth (1 / depth), which is 0 where nothing is drawn
void main() {
  vec3 p = move(vec3(x, y, z));
  float w = divide(1.0, p.z);
  EXACT float u = (lens.x * p.x) * w + lens.z;
  EXACT float v = (lens.y * p.y) * w + lens.w;
  corner = vec3(u, v, p.z > 0.1 ? w : 0.0);
}
)";

/// A triangle becomes the rectangle of pixels around it, and the fragments test its edges. The
/// driver's rasteriser would first snap the corners to some fraction of a pixel.
constexpr const char* kTriangleGeometry = R"(
layout(triangles) in;
layout(triangle_strip, max_vertices = 4) out;
in vec3 corner[];
flat out vec4 edges[3];  // column and row of its start; where it goes, the inside on one side
flat out vec3 plane;     // inverse_depth at the first corner; its slopes along columns and rows
flat out vec2 range;     // of inverse_depth

void main() {
  vec3 a = corner[0], b = corner[1], c = corner[2];
  vec3 low = min(a, min(b, c)), high = max(a, max(b, c));
  vec2 first = ceil(max(low.xy - 0.01, 0.0)), last = floor(min(high.xy + 0.01, size - 1.0));
  if (!(low.z > 0.0 && first.x <= last.x && first.y <= last.y)) return;
  EXACT float area = (b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y);
  if (area == 0.0) return;
  float turn = area > 0.0 ? 1.0 : -1.0, inverse = divide(1.0, area);
  EXACT float along_u = ((b.z - a.z) * (c.y - a.y) - (c.z - a.z) * (b.y - a.y)) * inverse;
  EXACT float along_v = ((c.z - a.z) * (b.x - a.x) - (b.z - a.z) * (c.x - a.x)) * inverse;
  for (int i = 0; i < 4; ++i) {
    edges[0] = vec4(a.xy, (b.xy - a.xy) * turn);
    edges[1] = vec4(b.xy, (c.xy - b.xy) * turn);
    edges[2] = vec4(c.xy, (a.xy - c.xy) * turn);
    plane = vec3(a.z, along_u, along_v);
    range = vec2(low.z, high.z);
    vec2 at = vec2((i & 1) != 0 ? last.x + 1.0 : first.x, (i & 2) != 0 ? last.y + 1.0 : first.y);
    gl_Position = vec4(at / size * 2.0 - 1.0, 0.0, 1.0);
    EmitVertex();
  }
}
)";

constexpr const char* kTriangleFragment = R"(
flat in vec4 edges[3];
flat in vec3 plane;
flat in vec2 range;
out float inverse_depth;

void main() {
  vec2 at = floor(gl_FragCoord.xy);
  for (int i = 0; i < 3; ++i) {
    vec4 e = edges[i];
    EXACT float slack = 0.01 * (abs(e.z) + abs(e.w));
    EXACT float side = (at.y - e.y) * e.z + (slack - (at.x - e.x) * e.w);
    if (!(side >= 0.0)) discard;
  }
  EXACT float w =
      (at.y - edges[0].y) * plane.z + ((at.x - edges[0].x) * plane.y + plane.x);
  inverse_depth = clamp(w, range.x, range.y);
}
)";

}  // namespace docdepth::gl
