#include <pybind11/stl.h>

#include <algorithm>
#include <memory>
#include <vector>

#include "arrays.hpp"
#include "docdepth/mesh/scan_mesh.hpp"

namespace docdepth::bindings {
namespace {

std::unique_ptr<ScanMesh> make_mesh(const Array<float>& points, const MeshParameters& parameters) {
  const PointMap map = as_points(points);
  const py::gil_scoped_release release;
  return std::make_unique<ScanMesh>(build_scan_mesh(map, parameters));
}

/// Join the meshes of several LiDARs into one. Each uses its own rows of the
/// same points.
std::unique_ptr<ScanMesh> join_meshes(const std::vector<ScanMesh*>& meshes) {
  auto joined = std::make_unique<ScanMesh>();
  const auto append = [](auto& to, const auto& from) {
    to.insert(to.end(), from.begin(), from.end());
  };
  for (const ScanMesh* mesh : meshes) {
    if (!mesh || mesh->points != meshes.front()->points)
      throw std::invalid_argument("only meshes of the same points can be joined");
    joined->points = mesh->points;
    append(joined->triangles, mesh->triangles);
    append(joined->discontinuity, mesh->discontinuity);
    append(joined->isolated, mesh->isolated);
  }
  std::sort(joined->isolated.begin(), joined->isolated.end());
  return joined;
}

/// A read-only array on the memory of a mesh. It keeps the mesh alive.
template <class T>
py::array_t<T> view(const py::object& mesh, const T* data, std::vector<py::ssize_t> shape) {
  py::array_t<T> array(std::move(shape), data, mesh);
  array.attr("flags").attr("writeable") = false;
  return array;
}

py::array_t<std::uint32_t> triangles(const py::object& self) {
  const auto& all = self.cast<const ScanMesh&>().triangles;
  return view(self, reinterpret_cast<const std::uint32_t*>(all.data()),
              {static_cast<py::ssize_t>(all.size()), 3});
}

template <class T, std::vector<T> ScanMesh::* kMember>
py::array_t<T> column(const py::object& self) {
  const auto& all = self.cast<const ScanMesh&>().*kMember;
  return view(self, all.data(), {static_cast<py::ssize_t>(all.size())});
}

}  // namespace

void bind_mesh(py::module_& m) {
  using namespace py::literals;
  py::class_<MeshParameters>(m, "MeshParameters")
      .def(py::init<>())
      .def_readwrite("max_gap", &MeshParameters::max_gap)
      .def_readwrite("jump_ratio", &MeshParameters::jump_ratio)
      .def_readwrite("gap_jump_ratio", &MeshParameters::gap_jump_ratio)
      .def_readwrite("noise", &MeshParameters::noise);
  py::class_<ScanMesh>(m, "ScanMesh")
      .def(py::init(&make_mesh), "points"_a, "parameters"_a)
      .def_property_readonly("triangles", &triangles)
      .def_property_readonly("discontinuity", &column<std::uint8_t, &ScanMesh::discontinuity>)
      .def_property_readonly("isolated", &column<std::uint32_t, &ScanMesh::isolated>);
  m.def("join_meshes", &join_meshes, "meshes"_a);
}

}  // namespace docdepth::bindings
