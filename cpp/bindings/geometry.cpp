#include "arrays.hpp"
#include "docdepth/geometry/nearest_neighbors.hpp"
#include "docdepth/geometry/sampled_points.hpp"

namespace docdepth::bindings {
namespace {

py::tuple find_nearest(const Array<float>& points, const Array<float>& queries, int threads) {
  const PointMap map = as_points(points), wanted = as_points(queries, "queries");
  NearestNeighbors found = without_gil([&] { return nearest_neighbors(map, wanted, threads); });
  return py::make_tuple(to_numpy(std::move(found.index)), to_numpy(std::move(found.distance)));
}

py::tuple thin_sweep(const Array<float>& points, const Array<float>& times, float size,
                     float min_range, float max_range) {
  const PointMap map = as_points(points);
  const float* column = as_column(times, map.rows(), "times");
  in_range(size, 1e-3, 100, "size");
  TimedPoints means =
      without_gil([&] { return downsample_sweep(map, column, size, min_range, max_range); });
  const auto count = static_cast<py::ssize_t>(means.points.size());
  Array<float> thinned({count, py::ssize_t{3}});
  for (py::ssize_t i = 0; i < count; ++i)
    for (int axis = 0; axis < 3; ++axis) thinned.mutable_at(i, axis) = means.points[i][axis];
  return py::make_tuple(thinned, to_numpy(std::move(means.times)));
}

}  // namespace

void bind_geometry(py::module_& m) {
  using namespace py::literals;
  m.def("nearest_neighbors", &find_nearest, "points"_a, "queries"_a, "threads"_a = 0);
  m.def("thin_sweep", &thin_sweep, "points"_a, "times"_a, "size"_a, "min_range"_a, "max_range"_a);
}

}  // namespace docdepth::bindings
