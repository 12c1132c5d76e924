#include "docdepth/surface/surface.hpp"

#include "arrays.hpp"

namespace docdepth::bindings {

namespace {

py::tuple surface(const Array<float>& points, const SurfaceParameters& parameters) {
  const auto view = as_points(points);
  Surface result;
  {
    const py::gil_scoped_release release;
    result = build_surface(view, parameters);
  }
  const auto count = static_cast<py::ssize_t>(result.triangles.size());
  const auto loose = static_cast<py::ssize_t>(result.loose.size());
  // (M, 3) corners are handed over as they lie in memory.
  auto* owner = new std::vector<std::array<std::uint32_t, 3>>(std::move(result.triangles));
  const py::capsule free(
      owner, [](void* p) { delete static_cast<std::vector<std::array<std::uint32_t, 3>>*>(p); });
  return py::make_tuple(
      py::array_t<std::uint32_t>({count, py::ssize_t{3}},
                                 reinterpret_cast<const std::uint32_t*>(owner->data()), free),
      to_numpy(std::move(result.cut), {count}), to_numpy(std::move(result.loose), {loose}));
}

}  // namespace

void bind_surface(py::module_& m) {
  py::class_<SurfaceParameters>(m, "SurfaceParameters")
      .def(py::init<>())
      .def_readwrite("max_gap", &SurfaceParameters::max_gap)
      .def_readwrite("jump_ratio", &SurfaceParameters::jump_ratio)
      .def_readwrite("noise", &SurfaceParameters::noise)
      .def_readwrite("flatness", &SurfaceParameters::flatness);
  m.def("surface", &surface, py::arg("points"), py::arg("parameters"));
}

}  // namespace docdepth::bindings
