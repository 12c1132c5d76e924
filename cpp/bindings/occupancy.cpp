#include <pybind11/stl.h>

#include "arrays.hpp"
#include "docdepth/occupancy/occupancy_grid.hpp"
#include "docdepth/occupancy/sweep_rays.hpp"

namespace docdepth::bindings {
namespace {

struct SweepRays {
  std::vector<Ray> rays;
};

SweepRays merged_rays(const Array<float>& points, const Array<float>& origins,
                      const Array<float>& seconds, const Array<std::uint16_t>& object,
                      const Array<bool>& ground, double cell) {
  const PointMap ends = as_points(points), begins = as_points(origins, "origins");
  const auto count = ends.rows();
  if (begins.rows() != count) throw std::invalid_argument("each point needs an origin");
  check_coordinates(points, "points"), check_coordinates(origins, "origins");
  const float* late = as_column(seconds, count, "seconds");
  const std::uint16_t* of = as_column(object, count, "object");
  const bool* flags = as_flags(ground, count, "ground");
  return without_gil([&] { return SweepRays{merge_rays(ends, begins, late, of, flags, cell)}; });
}

Eigen::Vector3d as_vector(const Array<double>& values, const char* name) {
  return Eigen::Map<const Eigen::Vector3d>(as_column(values, 3, name));
}

py::dict classified_voxels(const OccupancyGrid& grid, const std::vector<GridCamera>& cameras) {
  auto [found, seen] = without_gil([&] {
    OccupiedVoxels voxels = grid.classify();
    std::vector<std::uint8_t> visible = grid.seen_by(cameras, voxels);
    return std::pair(std::move(voxels), std::move(visible));
  });
  const auto& size = grid.options().size;
  const std::vector<py::ssize_t> shape(size.begin(), size.end());
  std::vector<std::uint8_t> occupied(found.occupied.size());
  for (std::size_t i = 0; i < occupied.size(); ++i) occupied[i] = std::uint8_t(found.occupied[i]);
  py::dict arrays;
  arrays["occupied"] = to_numpy(std::move(occupied), shape);
  arrays["object"] = to_numpy(std::move(found.object), shape);
  arrays["observed"] = to_numpy(std::move(found.observed), shape);
  arrays["seen"] = to_numpy(std::move(seen), shape);
  return arrays;
}

}  // namespace

void bind_occupancy(py::module_& m) {
  using namespace py::literals;
  py::class_<SweepRays>(m, "SweepRays")
      .def(py::init(&merged_rays), "points"_a, "origins"_a, "seconds"_a, "object"_a, "ground"_a,
           "cell"_a)
      .def("__len__", [](const SweepRays& self) { return self.rays.size(); });
  py::class_<OccupancyOptions>(m, "OccupancyOptions")
      .def(py::init<>())
      .def_readwrite("voxel", &OccupancyOptions::voxel)
      .def_readwrite("size", &OccupancyOptions::size)
      .def_property(
          "corner",
          [](const OccupancyOptions& o) {
            return std::array{o.corner.x(), o.corner.y(), o.corner.z()};
          },
          [](OccupancyOptions& o, const std::array<double, 3>& c) {
            o.corner = {c[0], c[1], c[2]};
          });
  py::class_<GridCamera>(m, "GridCamera")
      .def(py::init([](const Array<double>& K, int width, int height, const Array<double>& pose) {
             if (K.ndim() != 2 || K.shape(0) != 3 || K.shape(1) != 3)
               throw std::invalid_argument("K must be a float64 array of shape (3, 3)");
             using Matrix = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
             return GridCamera{Eigen::Map<const Matrix>(K.data()), width, height, as_pose(pose)};
           }),
           "K"_a, "width"_a, "height"_a, "T_grid_camera"_a);
  py::class_<OccupancyGrid>(m, "OccupancyGrid")
      .def(py::init<const OccupancyOptions&>(), "options"_a)
      .def(
          "add_object",
          [](OccupancyGrid& grid, std::uint16_t number, const Array<double>& pose,
             const Array<double>& size) {
            grid.add_object(number, as_pose(pose), as_vector(size, "size"));
          },
          "number"_a, "T_grid_object"_a, "size"_a)
      .def(
          "add_sweep",
          [](OccupancyGrid& grid, const SweepRays& sweep, const Array<double>& pose,
             std::uint16_t unfollowed) {
            const Pose T_grid_lidar = as_pose(pose);
            const py::gil_scoped_release release;
            grid.add_sweep(sweep.rays, T_grid_lidar, unfollowed);
          },
          "rays"_a, "T_grid_lidar"_a, "unfollowed"_a = 0)
      .def(
          "add_sweep_of_object",
          [](OccupancyGrid& grid, std::uint16_t number, std::uint16_t of_sweep,
             const SweepRays& sweep, const Array<double>& pose, const Array<double>& velocity) {
            const Pose T_grid_lidar = as_pose(pose);
            const Eigen::Vector3f speed = as_vector(velocity, "velocity").cast<float>();
            const py::gil_scoped_release release;
            grid.add_sweep_of_object(number, of_sweep, sweep.rays, T_grid_lidar, speed);
          },
          "number"_a, "of_sweep"_a, "rays"_a, "T_grid_lidar"_a, "velocity"_a)
      .def("classify", &classified_voxels, "cameras"_a);
}

}  // namespace docdepth::bindings
