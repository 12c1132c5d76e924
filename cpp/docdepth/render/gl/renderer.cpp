#include "docdepth/render/gl/renderer.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>

#include "docdepth/geometry/rigid.hpp"
#include "docdepth/render/behind_boxes.hpp"
#include "docdepth/render/depth_hypotheses.hpp"
#include "docdepth/render/gl/shaders.hpp"
#include "docdepth/render/straight_outlines.hpp"

namespace docdepth::gl {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();

void check(const GlContext::Current& gl, const std::string& renderer) {
  const unsigned error = gl->GetError();
  if (error == kOutOfMemory) throw GlError(renderer + " is out of memory; draw fewer sweeps");
  if (error) throw GlError(renderer + " failed with OpenGL error " + std::to_string(error));
}

/// A program of the sources of its vertex, geometry and fragment shader.
/// @throws GlError with the message of the driver
unsigned link(const GlContext::Current& gl, const std::array<const char*, 3>& sources) {
  const unsigned program = gl->CreateProgram();
  const unsigned kinds[] = {kVertexShader, kGeometryShader, kFragmentShader};
  for (std::size_t i = 0; i < 3; ++i) {
    const char* parts[] = {kExact, sources[i]};
    const unsigned shader = gl->CreateShader(kinds[i]);
    gl->ShaderSource(shader, 2, parts, nullptr);
    gl->CompileShader(shader);
    gl->AttachShader(program, shader);
    gl->DeleteShader(shader);
  }
  gl->LinkProgram(program);
  int linked = 0;
  gl->GetProgramiv(program, kLinkStatus, &linked);
  char log[1024] = "";
  gl->GetProgramInfoLog(program, sizeof log, nullptr, log);
  if (!linked) throw GlError(std::string("the driver does not link a program: ") + log);
  return program;
}

/// The image with rows of `stride` values, padded with zeros.
std::vector<float> widened(const std::vector<float>& image, std::size_t width, std::size_t stride) {
  std::vector<float> wide(image.size() / width * stride, 0.0f);
  for (std::size_t from = 0, to = 0; from < image.size(); from += width, to += stride)
    std::copy_n(&image[from], width, &wide[to]);
  return wide;
}

}  // namespace

GlRenderer::GlRenderer(const std::string& library, int device) : context_(library, device) {
  const Gl gl(context_);
  splats_ = link(gl, {kSplatVertex, kSplatGeometry, kSplatFragment});
  triangles_ = link(gl, {kTriangleVertex, kTriangleGeometry, kTriangleFragment});
  unsigned array = 0, framebuffer = 0;
  gl->GenVertexArrays(1, &array);
  gl->BindVertexArray(array);
  for (unsigned axis = 0; axis < 3; ++axis) gl->EnableVertexAttribArray(axis);
  gl->GenFramebuffers(1, &framebuffer);
  gl->BindFramebuffer(kFramebuffer, framebuffer);
  gl->GenRenderbuffers(1, &image_);
  gl->BindRenderbuffer(kRenderbuffer, image_);
  gl->Enable(kBlend);
  check(gl, context_.renderer());
}

/// Clear the image to `none`. Of all values drawn on a pixel the least (kMin) or greatest (kMax)
/// stays.
void GlRenderer::begin(const Gl& gl, const Camera& camera, unsigned program, unsigned keeps,
                       float none) {
  if (camera.width != width_ || camera.height != height_) {
    width_ = height_ = 0;
    gl->RenderbufferStorage(kRenderbuffer, kR32f, camera.width, camera.height);
    gl->FramebufferRenderbuffer(kFramebuffer, kColorAttachment0, kRenderbuffer, image_);
    if (gl->GetError() || gl->CheckFramebufferStatus(kFramebuffer) != kFramebufferComplete)
      throw GlError(context_.renderer() + " cannot draw float images of " +
                    std::to_string(camera.width) + " x " + std::to_string(camera.height) +
                    " pixels");
    gl->Viewport(0, 0, camera.width, camera.height);
    width_ = camera.width;
    height_ = camera.height;
  }
  gl->BlendEquation(keeps);
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

/// Coordinates of a cloud or a mesh as attributes 0 to 2, from its copy on the device.
template <class Shape>
GlRenderer::Uploaded& GlRenderer::bind(const Gl& gl, const Shape& shape, std::size_t size) {
  Uploaded& copy = uploaded_[shape.id()];
  copy.used = true;
  const auto bytes = static_cast<std::ptrdiff_t>(size * sizeof(float));
  const bool known = copy.coordinates;
  if (!known) gl->GenBuffers(1, &copy.coordinates);
  gl->BindBuffer(kArrayBuffer, copy.coordinates);
  if (!known) {
    gl->BufferData(kArrayBuffer, 3 * bytes, nullptr, kStaticDraw);
    gl->BufferSubData(kArrayBuffer, 0, bytes, shape.x());
    gl->BufferSubData(kArrayBuffer, bytes, bytes, shape.y());
    gl->BufferSubData(kArrayBuffer, 2 * bytes, bytes, shape.z());
  }
  for (unsigned axis = 0; axis < 3; ++axis)
    gl->VertexAttribPointer(axis, 1, kFloat, 0, 0, reinterpret_cast<const void*>(axis * bytes));
  return copy;
}

void GlRenderer::draw_cloud(const Gl& gl, const Camera& camera, const PlacedCloud& placed) {
  const Cloud& cloud = *placed.cloud;
  const Frustum frustum(camera, placed.T_camera_cloud);
  if (!cloud.size() || !frustum.touches(cloud.box())) return;
  std::vector<int> first, count;
  for (const auto& block : cloud.blocks()) {
    if (!frustum.touches(block.box)) continue;
    first.push_back(static_cast<int>(block.begin));
    count.push_back(static_cast<int>(block.end - block.begin));
  }
  if (first.empty()) return;

  const auto& limits = placed.heights->limits();
  const int largest = placed.heights->largest();
  if (largest > kLargestSplat)
    throw GlError("splats of " + std::to_string(largest) + " pixels are larger than the " +
                  std::to_string(kLargestSplat) + " of OpenGL here; the cpu draws any size");
  gl->Uniform1fv(gl->GetUniformLocation(splats_, "limits"), largest + 1, limits.data());
  gl->Uniform1i(gl->GetUniformLocation(splats_, "largest"), largest);
  place(gl, splats_, placed.T_camera_cloud);
  bind(gl, cloud, cloud.size());
  gl->MultiDrawArrays(kPoints, first.data(), count.data(), static_cast<int>(first.size()));
}

std::vector<float> GlRenderer::render_splats(const Camera& camera,
                                             const std::vector<PlacedCloud>& clouds) {
  return render([&](const Gl& gl) {
    constexpr float none = std::numeric_limits<float>::infinity();
    begin(gl, camera, splats_, kMin, none);
    for (const auto& placed : clouds) {
      draw_cloud(gl, camera, placed);
      gl->Finish();  // else Mesa queues all clouds, which takes gigabytes
    }
    auto depth = read(gl, camera);
    std::replace(depth.begin(), depth.end(), none, kNone);
    return depth;
  });
}

void GlRenderer::draw_mesh(const Gl& gl, const Camera& camera, const PlacedMesh& placed) {
  const PatchMesh& mesh = *placed.mesh;
  const Frustum frustum(camera, placed.T_camera_mesh);
  if (!mesh.size() || !frustum.touches(mesh.box())) return;
  std::vector<int> count, base;
  std::vector<const void*> corners;
  for (const auto& patch : mesh.patches()) {
    if (!frustum.touches(patch.box)) continue;
    count.push_back(static_cast<int>(3 * patch.triangles));
    base.push_back(static_cast<int>(patch.vertex));
    corners.push_back(reinterpret_cast<const void*>(patch.triangle * sizeof(PatchMesh::Corners)));
  }
  if (count.empty()) return;
  place(gl, triangles_, placed.T_camera_mesh);
  Uploaded& copy = bind(gl, mesh, mesh.vertex_count());
  const bool known = copy.corners;
  if (!known) gl->GenBuffers(1, &copy.corners);
  gl->BindBuffer(kElementArrayBuffer, copy.corners);
  if (!known)
    gl->BufferData(kElementArrayBuffer, std::ptrdiff_t(mesh.size() * sizeof(PatchMesh::Corners)),
                   mesh.corners(), kStaticDraw);
  gl->MultiDrawElementsBaseVertex(kTriangles, count.data(), kUnsignedByte, corners.data(),
                                  static_cast<int>(count.size()), base.data());
}

/// Inverse depth of the nearest triangle; 0 if there is none.
std::vector<float> GlRenderer::inverse_depth(const Gl& gl, const Camera& camera,
                                             const std::vector<PlacedMesh>& meshes) {
  begin(gl, camera, triangles_, kMax, 0);
  for (const auto& placed : meshes) draw_mesh(gl, camera, placed);
  return read(gl, camera);
}

std::vector<float> GlRenderer::render_triangles(const Camera& camera, const MeshScene& scene) {
  return render([&](const Gl& gl) {
    const int stride = (camera.width + DepthHypotheses::kTile - 1) / DepthHypotheses::kTile *
                       DepthHypotheses::kTile;
    const auto drawn = [&](const std::vector<PlacedMesh>& meshes) {
      return widened(inverse_depth(gl, camera, meshes), camera.width, stride);
    };
    const Columns columns{0, camera.width, camera.height, stride};
    DepthHypotheses hypotheses(columns, drawn(scene.nearest), drawn(scene.extrapolated));
    for (const auto& mesh : scene.others) hypotheses.add(drawn({mesh}).data());
    auto static_depth = hypotheses.resolve(camera, scene.rays);
    std::vector<std::uint16_t> wide(static_depth.size(), 0), shown_objects;
    std::uint16_t number = 0;
    for (const auto& object : scene.dynamic_objects)
      add_dynamic_object(columns, object.bounds, camera,
                         {drawn(object.nearest), drawn(object.others), drawn(object.extrapolated)},
                         object.rays, ++number, static_depth, wide);
    std::vector<float> depth(std::size_t(camera.width) * camera.height);
    for (std::size_t i = 0; i < depth.size(); ++i) {
      const std::size_t from = i / camera.width * stride + i % camera.width;
      depth[i] = static_depth[from] > 0 ? 1.0f / static_depth[from] : kNone;
      shown_objects.push_back(wide[from]);
    }
    straighten_outlines(camera, return_spacing(camera, scene), depth, shown_objects, 0);
    mask_unobserved_background(camera, scene, shown_objects, depth, 0);
    return depth;
  });
}

std::vector<float> GlRenderer::render(const std::function<std::vector<float>(const Gl&)>& draw) {
  const Gl gl(context_);
  try {
    auto depth = draw(gl);
    forget_unused(gl);
    return depth;
  } catch (...) {
    for (auto& copy : uploaded_) copy.second.used = false;  // its upload may have failed
    forget_unused(gl);
    throw;
  }
}

std::vector<float> GlRenderer::read(const Gl& gl, const Camera& camera) {
  std::vector<float> image(std::size_t(camera.width) * camera.height);
  gl->ReadPixels(0, 0, camera.width, camera.height, kRed, kFloat, image.data());
  check(gl, context_.renderer());
  return image;
}

void GlRenderer::forget_unused(const Gl& gl) {
  for (auto at = uploaded_.begin(); at != uploaded_.end();) {
    if (!at->second.used) {
      const unsigned buffers[] = {at->second.coordinates, at->second.corners};  // 0 is ignored
      gl->DeleteBuffers(2, buffers);
      at = uploaded_.erase(at);
    } else {
      at++->second.used = false;
    }
  }
}

}  // namespace docdepth::gl
