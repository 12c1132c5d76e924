// Depth maps by OpenGL: the same splats as render_splats(), and triangles.
#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

#include "docdepth/render/gl/context.hpp"
#include "docdepth/render/splats.hpp"

namespace docdepth::gl {

/// Triangles where they stood relative to the camera at the image's time; not copied.
struct PlacedTriangles {
  const float* vertices;  ///< x y z of each
  std::size_t vertex_count;
  const std::uint32_t* corners;  ///< three vertices a triangle
  std::size_t triangle_count;
  Pose T_camera_vertices;
};

/// Draws into a float image in which the smallest depth stays (blending by the minimum), so depth
/// is never rounded to a depth buffer's scale. For one thread and one process, as GlContext.
class GlRenderer {
 public:
  /// @throws GlError saying why the back end cannot be used here
  explicit GlRenderer(const Choice& choice);

  const GlContext& context() const { return context_; }
  int point_limit() const { return point_limit_; }  ///< pixels; larger splats are drawn as squares

  /// As docdepth::render_splats(). Clouds stay on the device until an image does without them.
  std::vector<float> render_splats(const Camera& camera, const std::vector<PlacedCloud>& clouds);

  /// z of the nearest triangle at each pixel's centre, exact in perspective; NaN where none is.
  /// Triangles are cut where they come nearer than kNear.
  std::vector<float> render_triangles(const Camera& camera,
                                      const std::vector<PlacedTriangles>& meshes);

 private:
  struct Uploaded {
    unsigned buffer;
    bool used;
  };

  void begin(const GlContext::Current& gl, const Camera& camera, unsigned program);
  void place(const GlContext::Current& gl, unsigned program, const Pose& T_camera_points);
  void draw(const GlContext::Current& gl, const Camera& camera, const PlacedCloud& placed);
  void bind_points(const GlContext::Current& gl, const Cloud& cloud);
  std::vector<float> read(const GlContext::Current& gl, const Camera& camera);
  void forget_unused(const GlContext::Current& gl);

  GlContext context_;
  int point_limit_ = 1, image_limit_ = 0;
  int width_ = 0, height_ = 0;  // of the image on the device
  unsigned image_ = 0, splats_ = 0, triangles_ = 0;
  std::unordered_map<std::uint64_t, Uploaded> clouds_;
};

}  // namespace docdepth::gl
