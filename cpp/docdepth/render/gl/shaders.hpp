// The programs of GlRenderer. They round like the CPU's renderer: see splats.cpp.
#pragma once

namespace docdepth::gl {

/// Most pixels that a splat may be high: the length of `limits`.
constexpr int kLargestSplat = 511;

/// A moved point, rounded as RigidTransform rounds it. `precise` keeps compilers from fusing.
constexpr const char* kMove = R"(#version 330 core
#extension GL_ARB_gpu_shader5 : enable
#ifdef GL_ARB_gpu_shader5
#define EXACT precise
#else
#define EXACT
#endif
uniform vec4 rows[3];  // of T_camera_points
uniform vec4 lens;     // fx, fy, cx, cy
uniform vec2 size;     // of the image

float row(vec4 r, vec3 p) {
  EXACT float moved = ((r.x * p.x + r.y * p.y) + r.z * p.z) + r.w;
  return moved;
}
vec3 move(vec3 p) { return vec3(row(rows[0], p), row(rows[1], p), row(rows[2], p)); }
)";

/// A splat as a point, or as one of the four corners of a square where points cannot be so large.
/// Its centre is snapped to a pixel and its edge is odd, so it covers the same pixels everywhere.
constexpr const char* kSplatVertex = R"(
layout(location = 0) in float x;
layout(location = 1) in float y;
layout(location = 2) in float z;
uniform float limits[512];  // largest squared distance at which a height is reached
uniform int largest;
uniform int as_squares;
flat out ivec3 splat;       // column, row, height
flat out float depth;

float high_bits(float a) { return intBitsToFloat(floatBitsToInt(a) & ~0xfff); }

// a / b as IEEE rounds it. GLSL's own quotient may be a few units off; its exact remainder, from
// products of halves (Dekker 1971), corrects it.
float divide(float a, float b) {
  EXACT float q = a / b;
  EXACT float q1 = high_bits(q), b1 = high_bits(b);
  EXACT float q2 = q - q1, b2 = b - b1;
  EXACT float remainder = ((a - q1 * b1) - q1 * b2 - q2 * b1) - q2 * b2;
  EXACT float rounded = q + remainder / b;
  return rounded;
}

int height(float squared) {
  int reached = 0, missed = largest + 1;
  while (missed - reached > 1) {
    int middle = (reached + missed) / 2;
    if (squared <= limits[middle]) reached = middle; else missed = middle;
  }
  return reached;
}

void main() {
  vec3 p = move(vec3(x, y, z));
  EXACT float fx_x = lens.x * p.x, fy_y = lens.y * p.y;
  EXACT float u = (divide(fx_x, p.z) + lens.z) + 0.5;
  EXACT float v = (divide(fy_y, p.z) + lens.w) + 0.5;
  EXACT float squared = (p.x * p.x + p.y * p.y) + p.z * p.z;
  gl_PointSize = 1.0;
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);  // outside of everything
  splat = ivec3(0);
  depth = p.z;
  if (!(p.z > 0.1 && u >= 0.0 && u < size.x && v >= 0.0 && v < size.y)) return;
  vec2 centre = floor(vec2(u, v));
  splat = ivec3(centre, height(squared));
  float half_edge = float(splat.z / 2) + 0.5;
  gl_PointSize = 2.0 * half_edge;
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  vec2 at = centre + 0.5 + (as_squares != 0 ? corner * half_edge : vec2(0.0));
  gl_Position = vec4(at / size * 2.0 - 1.0, 0.0, 1.0);
}
)";

constexpr const char* kSplatFragment = R"(#version 330 core
flat in ivec3 splat;
flat in float depth;
out float nearest;
void main() {
  ivec2 d = ivec2(gl_FragCoord.xy) - splat.xy;
  if (9 * d.x * d.x + 4 * d.y * d.y > splat.z * splat.z) discard;
  nearest = depth;
}
)";

/// w is z, so everything is interpolated in perspective, and 1/w is linear in the image.
constexpr const char* kTriangleVertex = R"(
layout(location = 0) in vec3 vertex;
void main() {
  vec3 p = move(vertex);
  vec2 at = lens.xy * p.xy + (lens.zw + 0.5) * p.z;
  gl_Position = vec4(at / size * 2.0 - p.z, p.z - 2.0 * 0.1, p.z);
}
)";

constexpr const char* kTriangleFragment = R"(#version 330 core
out float nearest;
void main() { nearest = 1.0 / gl_FragCoord.w; }
)";

}  // namespace docdepth::gl
