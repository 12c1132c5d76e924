#include <algorithm>
#include <memory>

#include "arrays.hpp"
#include "docdepth/odometry/gaussian_voxel_map.hpp"
#include "docdepth/odometry/oriented_points.hpp"

namespace docdepth::bindings {
namespace {

std::unique_ptr<OrientedPoints> orient(const Array<float>& points, int neighbors, int threads) {
  const PointMap map = as_points(points);
  check_coordinates(points, "points");
  in_range(neighbors, 5, 1000, "neighbors");
  return without_gil(
      [&] { return std::make_unique<OrientedPoints>(with_normals(map, neighbors, threads)); });
}

py::array_t<float> normals(const OrientedPoints& cloud) {
  py::array_t<float> rows({static_cast<py::ssize_t>(cloud.normals.size()), py::ssize_t{3}});
  for (std::size_t i = 0; i < cloud.normals.size(); ++i)
    for (int axis = 0; axis < 3; ++axis) rows.mutable_at(i, axis) = cloud.normals[i][axis];
  return rows;
}

std::unique_ptr<GaussianVoxelMap> make_map(double voxel_size, double tolerance) {
  RegistrationOptions options;
  options.voxel_size = in_range(voxel_size, 1e-3, 1e3, "voxel_size");
  options.tolerance = in_range(tolerance, 1e-3, 1e3, "tolerance");
  return std::make_unique<GaussianVoxelMap>(options);
}

void insert(GaussianVoxelMap& map, const OrientedPoints& cloud, const Array<double>& pose) {
  const Pose T_map_cloud = as_pose(pose);
  without_gil([&] { map.insert(cloud, T_map_cloud); });
}

py::tuple align(const GaussianVoxelMap& map, const OrientedPoints& cloud,
                const Array<double>& guess, int threads) {
  const Pose start = as_pose(guess);
  const Alignment found = without_gil([&] { return map.align(cloud, start, threads); });
  py::array_t<double> pose({4, 4}), hessian({6, 6});
  for (int i = 0; i < 4; ++i)
    for (int j = 0; j < 4; ++j) pose.mutable_at(i, j) = found.T_map_cloud.matrix()(i, j);
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) hessian.mutable_at(i, j) = found.hessian(i, j);
  return py::make_tuple(pose, hessian, found.inliers);
}

/// Keys (n,), and counts, sums and covariances (n, 10) of the voxels, in the order of keys.
py::tuple voxels(const GaussianVoxelMap& map) {
  std::vector<const GaussianVoxelMap::Voxel*> sorted;
  for (const auto& voxel : map.voxels()) sorted.push_back(&voxel);
  std::sort(sorted.begin(), sorted.end(), [](auto* a, auto* b) { return a->key < b->key; });
  std::vector<std::uint64_t> keys;
  py::array_t<double> values({static_cast<py::ssize_t>(sorted.size()), py::ssize_t{10}});
  for (const auto* voxel : sorted) {
    double* row = values.mutable_data(static_cast<py::ssize_t>(keys.size()), 0);
    *row++ = voxel->count;
    for (int i = 0; i < 3; ++i) *row++ = voxel->sum(i);
    for (int i = 0; i < 3; ++i)
      for (int j = i; j < 3; ++j) *row++ = voxel->covariance(i, j);
    keys.push_back(voxel->key);
  }
  return py::make_tuple(to_numpy(std::move(keys)), values);
}

}  // namespace

void bind_odometry(py::module_& m) {
  using namespace py::literals;
  py::class_<OrientedPoints>(m, "OrientedPoints")
      .def(py::init(&orient), "points"_a, "neighbors"_a, "threads"_a = 0)
      .def_property_readonly("normals", &normals);
  py::class_<GaussianVoxelMap>(m, "GaussianVoxelMap")
      .def(py::init(&make_map), "voxel_size"_a, "tolerance"_a = RegistrationOptions{}.tolerance)
      .def("voxels", &voxels)
      .def("insert", &insert, "cloud"_a, "T_map_cloud"_a)
      .def("align", &align, "cloud"_a, "guess"_a, "threads"_a = 0);
}

}  // namespace docdepth::bindings
