#include "docdepth/ground/ground.hpp"

#include <memory>

#include "arrays.hpp"

namespace docdepth::bindings {

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
      .def(py::init([](const GroundParameters& parameters, int threads) {
             return std::make_unique<GroundMap>(checked(parameters), checked_threads(threads));
           }),
           py::arg("parameters"), py::arg("threads") = 0)
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
      .def("grow", &GroundMap::grow, py::call_guard<py::gil_scoped_release>())
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
