#include "docdepth/surface/surface.hpp"

#include <pybind11/stl.h>

#include <algorithm>
#include <memory>
#include <vector>

#include "arrays.hpp"

namespace docdepth::bindings {
namespace {

std::unique_ptr<Surface> make_surface(const Array<float>& points,
                                      const SurfaceParameters& parameters) {
  const PointMap map = as_points(points);
  const py::gil_scoped_release release;
  return std::make_unique<Surface>(build_surface(map, parameters));
}

/// The surfaces of several LiDARs, each of its own rows of the same points, as one.
std::unique_ptr<Surface> join_surfaces(const std::vector<Surface*>& surfaces) {
  auto joined = std::make_unique<Surface>();
  for (const Surface* part : surfaces) {
    joined->points = part->points;
    joined->triangles.insert(joined->triangles.end(), part->triangles.begin(),
                             part->triangles.end());
    joined->cut.insert(joined->cut.end(), part->cut.begin(), part->cut.end());
    joined->loose.insert(joined->loose.end(), part->loose.begin(), part->loose.end());
  }
  std::sort(joined->loose.begin(), joined->loose.end());
  return joined;
}

/// An array that reads the memory of a surface and keeps it alive.
template <class T>
py::array_t<T> view(const py::object& surface, const T* data, std::vector<py::ssize_t> shape) {
  py::array_t<T> array(std::move(shape), data, surface);
  array.attr("flags").attr("writeable") = false;
  return array;
}

py::array_t<std::uint32_t> triangles(const py::object& self) {
  const auto& all = self.cast<const Surface&>().triangles;
  return view(self, reinterpret_cast<const std::uint32_t*>(all.data()),
              {static_cast<py::ssize_t>(all.size()), 3});
}

py::array_t<std::uint8_t> cut(const py::object& self) {
  const auto& all = self.cast<const Surface&>().cut;
  return view(self, all.data(), {static_cast<py::ssize_t>(all.size())});
}

py::array_t<std::uint32_t> loose(const py::object& self) {
  const auto& all = self.cast<const Surface&>().loose;
  return view(self, all.data(), {static_cast<py::ssize_t>(all.size())});
}

}  // namespace

void bind_surface(py::module_& m) {
  py::class_<SurfaceParameters>(m, "SurfaceParameters")
      .def(py::init<>())
      .def_readwrite("max_gap", &SurfaceParameters::max_gap)
      .def_readwrite("jump_ratio", &SurfaceParameters::jump_ratio)
      .def_readwrite("noise", &SurfaceParameters::noise)
      .def_readwrite("flatness", &SurfaceParameters::flatness);
  py::class_<Surface>(m, "Surface")
      .def(py::init(&make_surface), py::arg("points"), py::arg("parameters"))
      .def_property_readonly("triangles", &triangles)
      .def_property_readonly("cut", &cut)
      .def_property_readonly("loose", &loose);
  m.def("join_surfaces", &join_surfaces, py::arg("surfaces"));
}

}  // namespace docdepth::bindings
