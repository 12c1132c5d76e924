// Depth maps by OpenGL, equal to those of render_splats() and render_triangles().
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <unordered_map>
#include <vector>

#include "docdepth/render/gl/context.hpp"
#include "docdepth/render/splats.hpp"
#include "docdepth/render/triangles.hpp"

namespace docdepth::gl {

/// Draws into a float image that keeps the smallest depth or the largest inverse depth (blending by
/// minimum or maximum), so that no depth buffer rounds the values. Clouds and meshes stay on the
/// device until a depth map does not need them. For one thread and one process, like GlContext.
class GlRenderer {
 public:
  /// @param library, device as those of GlContext
  /// @throws GlError saying why OpenGL cannot be used here
  explicit GlRenderer(const std::string& library, int device = -1);

  const GlContext& context() const { return context_; }

  /// As docdepth::render_splats().
  std::vector<float> render_splats(const Camera& camera, const std::vector<PlacedCloud>& clouds);

  /// As docdepth::render_triangles().
  std::vector<float> render_triangles(const Camera& camera, const MeshScene& scene);

 private:
  using Gl = GlContext::Current;
  struct Uploaded {
    unsigned coordinates = 0, corners = 0;  // buffers
    bool used = false;                      // in this depth map
  };

  std::vector<float> render(const std::function<std::vector<float>(const Gl&)>& draw);
  void begin(const Gl& gl, const Camera& camera, unsigned program, unsigned keeps, float none);
  void place(const Gl& gl, unsigned program, const Pose& T_camera_points);
  void draw_cloud(const Gl& gl, const Camera& camera, const PlacedCloud& placed);
  void draw_mesh(const Gl& gl, const Camera& camera, const PlacedMesh& placed);
  template <class Shape>
  Uploaded& bind(const Gl& gl, const Shape& shape, std::size_t size);
  std::vector<float> inverse_depth(const Gl& gl, const Camera& camera,
                                   const std::vector<PlacedMesh>& meshes);
  std::vector<float> read(const Gl& gl, const Camera& camera);
  void forget_unused(const Gl& gl);

  GlContext context_;
  int width_ = 0, height_ = 0;  // of the image on the device
  unsigned image_ = 0;
  unsigned splats_ = 0, triangles_ = 0;  // programs
  std::unordered_map<std::uint64_t, Uploaded> uploaded_;
};

}  // namespace docdepth::gl
