#include <memory>

#include "docdepth/render/gl/renderer.hpp"
#include "render.hpp"

namespace docdepth::bindings {
namespace {

using gl::GlRenderer;

std::unique_ptr<GlRenderer> open(const std::string& library, int device) {
  const py::gil_scoped_release release;
  return std::make_unique<GlRenderer>(library, device);
}

// The driver has its own threads. The argument makes this a drop-in for the processor's renderer.
py::array_t<float> gl_draw_splats(GlRenderer& renderer, const Array<double>& K, int width,
                                  int height, const std::vector<Placed>& static_frames,
                                  const std::vector<Placed>& dynamic_frames,
                                  const Size& static_size, const Size& dynamic_size,
                                  int /*threads*/) {
  const Camera camera = as_camera(K, width, height);
  const PlacedClouds placed(static_frames, dynamic_frames, static_size, dynamic_size);
  std::vector<float> depth;
  {
    const py::gil_scoped_release release;
    depth = renderer.render_splats(camera, placed.clouds);
  }
  return to_numpy(std::move(depth), {height, width});
}

py::array_t<float> gl_draw_meshes(GlRenderer& renderer, const Array<double>& K, int width,
                                  int height, const std::vector<PlacedFrame>& static_frames,
                                  const std::vector<ObjectOf>& objects, int visibility_sweeps,
                                  int /*threads*/, const std::vector<ShutterOf>& shutter_sweeps,
                                  const std::vector<BoxOf>& boxes, int nearest_frames) {
  const Camera camera = as_camera(K, width, height);
  const auto frames = as_mesh_frames(static_frames);
  const auto sighted = as_objects(objects);
  const auto shutter = as_shutter_sweeps(shutter_sweeps);
  const auto placed = as_boxes(boxes);
  in_range(visibility_sweeps, 0, kMaxRows, "visibility_sweeps");
  in_range(nearest_frames, 1, kMaxRows, "nearest_frames");
  std::vector<float> depth;
  {
    const py::gil_scoped_release release;
    depth = renderer.render_triangles(
        camera,
        compose_scene(camera, frames, sighted, visibility_sweeps, shutter, placed, nearest_frames));
  }
  return to_numpy(std::move(depth), {height, width});
}

}  // namespace

void bind_gl(py::module_& m) {
  using namespace py::literals;
  py::register_exception<gl::GlError>(m, "GlError",
                                      py::module_::import("docdepth.errors").attr("BackendError"));
  m.def("egl_devices", &gl::egl_devices);
  py::class_<GlRenderer>(m, "GlRenderer")
      .def(py::init(&open), "library"_a, "device"_a = -1)
      .def_property_readonly("renderer", [](const GlRenderer& r) { return r.context().renderer(); })
      .def("render_splats", &gl_draw_splats, "K"_a, "width"_a, "height"_a, "static_frames"_a,
           "dynamic_frames"_a, "static_size"_a, "dynamic_size"_a, "threads"_a = 0)
      .def("render_meshes", &gl_draw_meshes, "K"_a, "width"_a, "height"_a, "static_frames"_a,
           "objects"_a, "visibility_sweeps"_a, "threads"_a = 0, "shutter_sweeps"_a = py::list(),
           "boxes"_a = py::list(), "nearest_frames"_a = 1);
}

}  // namespace docdepth::bindings
