#include "docdepth/ground/ground.hpp"

#include <pybind11/stl.h>

#include <chrono>
#include <future>
#include <memory>
#include <optional>

#include "arrays.hpp"

namespace docdepth::bindings {
namespace {

/// Grow in another thread, so that Ctrl-C is noticed.
std::size_t grow(GroundMap& map) {
  auto grown = std::async(std::launch::async, [&map] { return map.grow(); });
  const auto is_done = [&](std::chrono::milliseconds wait) {
    const py::gil_scoped_release release;
    return grown.wait_for(wait) == std::future_status::ready;
  };
  while (!is_done(std::chrono::milliseconds(100))) {
    if (PyErr_CheckSignals() == 0) continue;
    map.stop();
    while (!is_done(std::chrono::milliseconds(100))) {
    }
    throw py::error_already_set();
  }
  return grown.get();
}

}  // namespace

void bind_ground(py::module_& m) {
  py::class_<GroundParameters>(m, "GroundParameters")
      .def(py::init<>())
      .def_readwrite("voxel_size", &GroundParameters::voxel_size)
      .def_readwrite("seed_radius", &GroundParameters::seed_radius)
      .def_readwrite("seed_quantile", &GroundParameters::seed_quantile)
      .def_readwrite("least_share", &GroundParameters::least_share)
      .def_readwrite("step_height", &GroundParameters::step_height)
      .def_readwrite("neighbors", &GroundParameters::neighbors)
      .def_readwrite("plane_distance", &GroundParameters::plane_distance)
      .def_readwrite("max_slope", &GroundParameters::max_slope);

  py::class_<GroundMap>(m, "GroundMap")
      .def(py::init([](const GroundParameters& parameters, int threads,
                       const std::optional<Array<double>>& corner) {
             std::optional<Eigen::Vector3d> at;
             if (corner) at = Eigen::Map<const Eigen::Vector3d>(as_column(*corner, 3, "corner"));
             return std::make_unique<GroundMap>(parameters, threads, at);
           }),
           py::arg("parameters"), py::arg("threads") = 0, py::arg("corner") = py::none())
      .def("__len__", &GroundMap::size)
      .def(
          "insert",
          [](GroundMap& map, const Array<float>& points, const Array<double>& pose) {
            const auto view = as_points(points);
            const Pose T_world_lidar = as_pose(pose);
            py::gil_scoped_release release;
            map.insert(view, T_world_lidar);
          },
          py::arg("points"), py::arg("T_world_lidar"))
      .def("grow", &grow)
      .def(
          "label",
          [](const GroundMap& map, const Array<float>& points, const Array<double>& pose) {
            const auto view = as_points(points);
            const Pose T_world_lidar = as_pose(pose);
            py::array_t<bool> ground(view.rows());
            bool* data = ground.mutable_data();
            {
              py::gil_scoped_release release;
              map.label(view, T_world_lidar, data);
            }
            return ground;
          },
          py::arg("points"), py::arg("T_world_lidar"));
}

}  // namespace docdepth::bindings
