#include "render.hpp"

#include <memory>

#include "docdepth/render/edges.hpp"
#include "docdepth/render/mesh.hpp"
#include "docdepth/render/triangles.hpp"
namespace docdepth::bindings {
namespace {

std::unique_ptr<Frame> make_frame(const Array<float>& points, const Array<std::uint16_t>& classid,
                                  double crop) {
  const PointMap map = as_points(points);
  const std::uint16_t* classes = as_column(classid, map.rows(), "classid");
  const py::gil_scoped_release release;
  return std::make_unique<Frame>(map, classes, crop);
}

py::array_t<float> splats(const Array<double>& K, int width, int height,
                          const std::vector<Placed>& static_frames,
                          const std::vector<Placed>& dynamic_frames, const Size& static_size,
                          const Size& dynamic_size, int threads) {
  const Camera camera = as_camera(K, width, height);
  const PlacedClouds placed(static_frames, dynamic_frames, static_size, dynamic_size);
  std::vector<float> depth;
  {
    const py::gil_scoped_release release;
    depth = render_splats(camera, placed.clouds, threads);
  }
  return to_numpy(std::move(depth), {height, width});
}

py::tuple parted(const Array<float>& points, const Array<std::uint32_t>& triangles,
                 const Array<std::uint8_t>& cut, const Array<std::uint16_t>& classid) {
  const PointMap map = as_points(points);
  const auto surface =
      part_surface(map, reinterpret_cast<const std::uint32_t (*)[3]>(triangles.data()), cut.data(),
                   triangles.shape(0), as_column(classid, map.rows(), "classid"));
  const auto make = [&](const Triangles& t) { return Mesh(surface.vertices, t); };
  return py::make_tuple(make(surface.fixed.whole), make(surface.fixed.near),
                        make(surface.fixed.far), make(surface.moving.whole),
                        make(surface.moving.near), make(surface.moving.far));
}

py::array_t<float> triangles(
    const Array<double>& K, int width, int height,
    const std::vector<std::tuple<const Mesh*, Array<double>, float>>& meshes, int threads) {
  const Camera camera = as_camera(K, width, height);
  std::vector<PlacedMesh> placed;
  for (const auto& [mesh, pose, tolerance] : meshes)
    placed.push_back({mesh, as_pose(pose), tolerance});
  std::vector<float> depth;
  {
    const py::gil_scoped_release release;
    depth = render_triangles(camera, placed, threads);
  }
  return to_numpy(std::move(depth), {height, width});
}

}  // namespace

void bind_render(py::module_& m) {
  using namespace py::literals;
  py::class_<Frame>(m, "Frame")
      .def(py::init(&make_frame), "points"_a, "classid"_a, "crop"_a)
      .def_property_readonly("static_size",
                             [](const Frame& frame) { return frame.static_points.size(); })
      .def_property_readonly("dynamic_size",
                             [](const Frame& frame) { return frame.dynamic_points.size(); });
  py::class_<Mesh>(m, "Mesh").def_property_readonly("size", &Mesh::size);
  m.def("parted", &parted);
  m.def("render_triangles", &triangles, "K"_a, "width"_a, "height"_a, "meshes"_a, "threads"_a = 0);
  m.def("render_splats", &splats, "K"_a, "width"_a, "height"_a, "static_frames"_a,
        "dynamic_frames"_a, "static_size"_a, "dynamic_size"_a, "threads"_a = 0);
}

}  // namespace docdepth::bindings
