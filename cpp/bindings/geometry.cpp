#include "arrays.hpp"
#include "docdepth/geometry/nearest_neighbors.hpp"

namespace docdepth::bindings {
namespace {

py::tuple find_nearest(const Array<float>& points, const Array<float>& queries, int threads) {
  const PointMap map = as_points(points), wanted = as_points(queries, "queries");
  threads = checked_threads(threads);
  NearestNeighbors found;
  {
    const py::gil_scoped_release release;
    found = nearest_neighbors(map, wanted, threads);
  }
  const auto count = static_cast<py::ssize_t>(wanted.rows());
  return py::make_tuple(to_numpy(std::move(found.index), {count}),
                        to_numpy(std::move(found.distance), {count}));
}

}  // namespace

void bind_geometry(py::module_& m) {
  using namespace py::literals;
  m.def("nearest_neighbors", &find_nearest, "points"_a, "queries"_a, "threads"_a = 0);
}

}  // namespace docdepth::bindings
