#include "docdepth/render/gl/renderer.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "docdepth/geometry/rigid.hpp"
#include "docdepth/render/gl/shaders.hpp"

namespace docdepth::gl {
namespace {

using Gl = GlContext::Current;

unsigned compile(const Gl& gl, unsigned type, const std::vector<const char*>& sources) {
  const unsigned shader = gl->CreateShader(type);
  gl->ShaderSource(shader, static_cast<int>(sources.size()), sources.data(), nullptr);
  gl->CompileShader(shader);
  int well = 0;
  gl->GetShaderiv(shader, kCompileStatus, &well);
  if (!well) {
    char log[1024] = "";
    gl->GetShaderInfoLog(shader, sizeof log, nullptr, log);
    throw GlError(std::string("the driver does not compile a shader: ") + log);
  }
  return shader;
}

unsigned link(const Gl& gl, const char* vertex, const char* fragment) {
  const unsigned program = gl->CreateProgram();
  for (const unsigned shader :
       {compile(gl, kVertexShader, {kMove, vertex}), compile(gl, kFragmentShader, {fragment})}) {
    gl->AttachShader(program, shader);
    gl->DeleteShader(shader);
  }
  gl->LinkProgram(program);
  int well = 0;
  gl->GetProgramiv(program, kLinkStatus, &well);
  if (!well) {
    char log[1024] = "";
    gl->GetProgramInfoLog(program, sizeof log, nullptr, log);
    throw GlError(std::string("the driver does not link a program: ") + log);
  }
  return program;
}

void check(const Gl& gl, const std::string& renderer) {
  const unsigned error = gl->GetError();
  if (error == kOutOfMemory) throw GlError(renderer + " is out of memory; draw fewer sweeps");
  if (error) throw GlError(renderer + " failed with OpenGL error " + std::to_string(error));
}

/// Ranges of points whose blocks the camera may see.
void visible_ranges(const Cloud& cloud, const Frustum& frustum, std::vector<int>& first,
                    std::vector<int>& count) {
  for (const auto& block : cloud.blocks()) {
    if (!frustum.touches(block.box)) continue;
    const int begin = static_cast<int>(block.begin), size = static_cast<int>(block.end) - begin;
    if (!first.empty() && first.back() + count.back() == begin) {
      count.back() += size;
    } else {
      first.push_back(begin);
      count.push_back(size);
    }
  }
}

}  // namespace

GlRenderer::GlRenderer(const Choice& choice) : context_(choice) {
  const Gl gl(context_);
  float point_sizes[2] = {1, 1};
  gl->GetFloatv(kPointSizeRange, point_sizes);
  point_limit_ = static_cast<int>(point_sizes[1]);
  int viewport[2] = {0, 0}, renderbuffer = 0;
  gl->GetIntegerv(kMaxViewportSize, viewport);
  gl->GetIntegerv(kMaxRenderbufferSize, &renderbuffer);
  image_limit_ = std::min({viewport[0], viewport[1], renderbuffer});
  splats_ = link(gl, kSplatVertex, kSplatFragment);
  triangles_ = link(gl, kTriangleVertex, kTriangleFragment);

  unsigned array = 0, framebuffer = 0;
  gl->GenVertexArrays(1, &array);
  gl->BindVertexArray(array);
  gl->GenFramebuffers(1, &framebuffer);
  gl->BindFramebuffer(kFramebuffer, framebuffer);
  gl->GenRenderbuffers(1, &image_);
  gl->BindRenderbuffer(kRenderbuffer, image_);
  gl->Enable(kProgramPointSize);
  gl->Enable(kBlend);
  gl->BlendEquation(kMin);
  check(gl, context_.renderer());
}

void GlRenderer::begin(const Gl& gl, const Camera& camera, unsigned program) {
  if (camera.width > image_limit_ || camera.height > image_limit_)
    throw GlError(context_.renderer() + " draws images of at most " + std::to_string(image_limit_) +
                  " pixels");
  if (camera.width != width_ || camera.height != height_) {
    width_ = height_ = 0;
    gl->RenderbufferStorage(kRenderbuffer, kR32f, camera.width, camera.height);
    gl->FramebufferRenderbuffer(kFramebuffer, kColorAttachment0, kRenderbuffer, image_);
    if (gl->CheckFramebufferStatus(kFramebuffer) != kFramebufferComplete)
      throw GlError(context_.renderer() + " cannot draw float images");
    gl->Viewport(0, 0, camera.width, camera.height);
    width_ = camera.width, height_ = camera.height;
  }
  const float none = std::numeric_limits<float>::infinity();
  const float clear[4] = {none, none, none, none};
  gl->ClearBufferfv(kColor, 0, clear);
  gl->UseProgram(program);
  const float lens[4] = {float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)};
  gl->Uniform4fv(gl->GetUniformLocation(program, "lens"), 1, lens);
  gl->Uniform2f(gl->GetUniformLocation(program, "size"), float(camera.width), float(camera.height));
}

void GlRenderer::place(const Gl& gl, unsigned program, const Pose& T_camera_points) {
  const RigidTransform T(T_camera_points);
  float rows[12];
  for (int i = 0; i < 3; ++i) {
    std::copy(T.r[i], T.r[i] + 3, rows + 4 * i);
    rows[4 * i + 3] = T.t[i];
  }
  gl->Uniform4fv(gl->GetUniformLocation(program, "rows"), 3, rows);
}

void GlRenderer::bind_points(const Gl& gl, const Cloud& cloud) {
  const auto [at, added] = clouds_.try_emplace(cloud.id(), Uploaded{0, true});
  at->second.used = true;
  if (!added) {
    gl->BindBuffer(kArrayBuffer, at->second.buffer);
    return;
  }
  gl->GenBuffers(1, &at->second.buffer);
  gl->BindBuffer(kArrayBuffer, at->second.buffer);
  const auto bytes = static_cast<std::ptrdiff_t>(cloud.size() * sizeof(float));
  gl->BufferData(kArrayBuffer, 3 * bytes, nullptr, kStaticDraw);
  gl->BufferSubData(kArrayBuffer, 0, bytes, cloud.x());
  gl->BufferSubData(kArrayBuffer, bytes, bytes, cloud.y());
  gl->BufferSubData(kArrayBuffer, 2 * bytes, bytes, cloud.z());
}

void GlRenderer::draw(const Gl& gl, const Camera& camera, const PlacedCloud& placed) {
  const Cloud& cloud = *placed.cloud;
  const Frustum frustum(camera, placed.T_camera_cloud);
  if (!cloud.size() || !frustum.touches(cloud.box())) return;
  std::vector<int> first, count;
  visible_ranges(cloud, frustum, first, count);
  if (first.empty()) return;

  const auto& limits = placed.heights->limits();
  const int largest = placed.heights->largest();
  if (largest > kLargestSplat)
    throw GlError("splats of " + std::to_string(largest) + " pixels are larger than the " +
                  std::to_string(kLargestSplat) + " of OpenGL here; the cpu draws any size");
  gl->Uniform1fv(gl->GetUniformLocation(splats_, "limits"), largest + 1, limits.data());
  gl->Uniform1i(gl->GetUniformLocation(splats_, "largest"), largest);
  const bool squares = largest > point_limit_;
  gl->Uniform1i(gl->GetUniformLocation(splats_, "as_squares"), squares);
  place(gl, splats_, placed.T_camera_cloud);

  bind_points(gl, cloud);
  for (unsigned axis = 0; axis < 3; ++axis) {
    gl->EnableVertexAttribArray(axis);
    gl->VertexAttribDivisor(axis, squares ? 1 : 0);
    gl->VertexAttribPointer(axis, 1, kFloat, 0, 0,
                            reinterpret_cast<const void*>(axis * cloud.size() * sizeof(float)));
  }
  if (squares)
    gl->DrawArraysInstanced(kTriangleStrip, 0, 4, static_cast<int>(cloud.size()));
  else
    gl->MultiDrawArrays(kPoints, first.data(), count.data(), static_cast<int>(first.size()));
}

std::vector<float> GlRenderer::render_splats(const Camera& camera,
                                             const std::vector<PlacedCloud>& clouds) {
  const Gl gl(context_);
  begin(gl, camera, splats_);
  try {
    for (const auto& placed : clouds) draw(gl, camera, placed);
    auto depth = read(gl, camera);
    forget_unused(gl);
    return depth;
  } catch (...) {
    for (auto& cloud : clouds_) cloud.second.used = false;  // their points may not have arrived
    forget_unused(gl);
    throw;
  }
}

std::vector<float> GlRenderer::render_triangles(const Camera& camera,
                                                const std::vector<PlacedTriangles>& meshes) {
  const Gl gl(context_);
  begin(gl, camera, triangles_);
  for (unsigned axis = 0; axis < 3; ++axis) gl->DisableVertexAttribArray(axis);
  gl->EnableVertexAttribArray(0);
  gl->VertexAttribDivisor(0, 0);
  unsigned buffers[2];
  gl->GenBuffers(2, buffers);
  gl->BindBuffer(kArrayBuffer, buffers[0]);
  gl->BindBuffer(kElementArrayBuffer, buffers[1]);
  gl->VertexAttribPointer(0, 3, kFloat, 0, 0, nullptr);
  for (const auto& mesh : meshes) {
    const std::size_t corners = 3 * mesh.triangle_count;
    gl->BufferData(kArrayBuffer, std::ptrdiff_t(3 * mesh.vertex_count * sizeof(float)),
                   mesh.vertices, kStaticDraw);
    gl->BufferData(kElementArrayBuffer, std::ptrdiff_t(corners * sizeof(std::uint32_t)),
                   mesh.corners, kStaticDraw);
    place(gl, triangles_, mesh.T_camera_vertices);
    gl->DrawElements(kTriangles, static_cast<int>(corners), kUnsignedInt, nullptr);
  }
  auto depth = read(gl, camera);
  gl->DeleteBuffers(2, buffers);
  return depth;
}

std::vector<float> GlRenderer::read(const Gl& gl, const Camera& camera) {
  std::vector<float> depth(std::size_t(camera.width) * camera.height);
  gl->ReadPixels(0, 0, camera.width, camera.height, kRed, kFloat, depth.data());
  check(gl, context_.renderer());
  for (float& z : depth)
    if (std::isinf(z)) z = std::numeric_limits<float>::quiet_NaN();
  return depth;
}

void GlRenderer::forget_unused(const Gl& gl) {
  for (auto at = clouds_.begin(); at != clouds_.end();) {
    if (!at->second.used) {
      gl->DeleteBuffers(1, &at->second.buffer);
      at = clouds_.erase(at);
    } else {
      at++->second.used = false;
    }
  }
}

}  // namespace docdepth::gl
