#include "render.hpp"

#include <algorithm>
#include <memory>
#include <optional>

#include "docdepth/render/layers.hpp"

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

/// Of as many lines of sight as points; the points where none are given.
PointMap starts_of(const std::optional<Array<float>>& starts, const PointMap& points) {
  const PointMap map = starts ? as_points(*starts) : points;
  if (map.rows() != points.rows()) throw std::invalid_argument("starts must be as many as points");
  return map;
}

std::unique_ptr<SurfaceFrame> make_surface_frame(
    const Array<float>& points, const Array<std::uint16_t>& classid,
    const Array<std::uint32_t>& triangles, const Array<std::uint8_t>& cut,
    const Array<std::uint32_t>& loose, float loose_angle, const std::optional<Array<float>>& late,
    const std::optional<Array<float>>& starts) {
  const PointMap map = as_points(points);
  const Points from = starts_of(starts, map);
  const std::uint16_t* classes = as_column(classid, map.rows(), "classid");
  const py::ssize_t count = triangles.shape(0);
  const std::uint8_t* cuts = as_column(cut, count, "cut");
  const float* times = late ? as_column(*late, map.rows(), "late") : nullptr;
  const auto* corners = reinterpret_cast<const std::uint32_t (*)[3]>(triangles.data());
  const py::gil_scoped_release release;
  return std::make_unique<SurfaceFrame>(map, corners, cuts, count, loose.data(), loose.size(),
                                        loose_angle, classes, times, starts ? &from : nullptr);
}

py::array_t<float> surfaces(const Array<double>& K, int width, int height,
                            const std::vector<PlacedFrame>& fixed,
                            const std::vector<MovingFrame>& moving, float max_speed, int witnesses,
                            int threads) {
  const Camera camera = as_camera(K, width, height);
  const auto world = as_surfaces(fixed);
  const Motion motion = as_motion(moving, max_speed);
  std::vector<float> depth;
  {
    const py::gil_scoped_release release;
    depth = render_surfaces(camera, world, motion, witnesses, threads);
  }
  return to_numpy(std::move(depth), {height, width});
}

std::unique_ptr<Rays> make_rays(const Array<float>& points, const Array<float>& normals,
                                const std::optional<Array<float>>& starts) {
  const PointMap map = as_points(points), directions = as_points(normals);
  const Points from = starts_of(starts, map);
  if (directions.rows() != map.rows())
    throw std::invalid_argument("normals must be as many as points");
  const py::gil_scoped_release release;
  std::vector<Eigen::Vector3f> rows;
  for (Eigen::Index i = 0; i < map.rows(); ++i) rows.push_back(directions.row(i));
  return std::make_unique<Rays>(map, rows, starts ? &from : nullptr);
}

py::array_t<float> ask(const Rays& rays, const Array<float>& places) {
  const PointMap map = as_points(places);
  std::vector<float> balance(map.rows(), 0.0f);
  {
    const py::gil_scoped_release release;
    Places some;
    for (Eigen::Index first = 0; first < map.rows(); first += Eigen::Index(some.size)) {
      some.size = std::min<std::size_t>(map.rows() - first, Places::kMost);
      for (std::size_t i = 0; i < some.size; ++i)
        some.x[i] = map(first + i, 0), some.y[i] = map(first + i, 1), some.z[i] = map(first + i, 2);
      rays.ask(some, kBlur, balance.data() + first);
    }
  }
  return to_numpy(std::move(balance), {map.rows()});
}

py::dict as_dict(Layers&& layers, int width, int height) {
  using namespace py::literals;
  const std::vector<py::ssize_t> shape{height, width};
  py::dict dict;
  if (!layers.normal.empty())
    dict["normal"] = to_numpy(std::move(layers.normal), {height, width, 3});
  dict["sweep"] = to_numpy(std::move(layers.sweep), shape);
  dict["class"] = to_numpy(std::move(layers.classid), shape);
  dict["measured"] = to_numpy(std::move(layers.measured), shape);
  dict["range"] = to_numpy(std::move(layers.range), shape);
  dict["support"] = to_numpy(std::move(layers.support), shape);
  dict["measures"] = to_numpy(std::move(layers.measures), shape);
  dict["std"] = to_numpy(std::move(layers.deviation), shape);
  return dict;
}

const float* as_depth(const Array<float>& depth, int width, int height) {
  if (depth.ndim() != 2 || depth.shape(0) != height || depth.shape(1) != width)
    throw std::invalid_argument("depth must have the shape of the image");
  return depth.data();
}

py::dict splat_layers(const Array<double>& K, int width, int height,
                      const std::vector<Placed>& static_frames,
                      const std::vector<Placed>& dynamic_frames, const Size& static_size,
                      const Size& dynamic_size, const Array<float>& depth, int threads) {
  const Camera camera = as_camera(K, width, height);
  const PlacedClouds placed(static_frames, dynamic_frames, static_size, dynamic_size);
  const float* z = as_depth(depth, width, height);
  std::optional<Layers> layers;
  {
    const py::gil_scoped_release release;
    layers = layers_of_splats(camera, placed.clouds, z, threads);
  }
  return as_dict(std::move(*layers), width, height);
}

py::dict surface_layers(const Array<double>& K, int width, int height,
                        const std::vector<PlacedFrame>& fixed,
                        const std::vector<MovingFrame>& moving, float max_speed, int witnesses,
                        const Array<float>& depth, int threads) {
  const Camera camera = as_camera(K, width, height);
  const auto world = as_surfaces(fixed);
  const Motion motion = as_motion(moving, max_speed);
  const float* z = as_depth(depth, width, height);
  std::optional<Layers> layers;
  {
    const py::gil_scoped_release release;
    layers = layers_of_triangles(camera, drawing_of(camera, world, motion, witnesses, threads), z,
                                 threads);
  }
  return as_dict(std::move(*layers), width, height);
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
  py::class_<SurfaceFrame>(m, "SurfaceFrame")
      .def(py::init(&make_surface_frame), "points"_a, "classid"_a, "triangles"_a, "cut"_a,
           "loose"_a, "loose_angle"_a, "late"_a = py::none(), "starts"_a = py::none());
  py::class_<Rays>(m, "Rays")
      .def(py::init(&make_rays), "points"_a, "normals"_a, "starts"_a = py::none())
      .def("ask", &ask, "places"_a);
  m.def("render_surfaces", &surfaces, "K"_a, "width"_a, "height"_a, "fixed"_a, "moving"_a,
        "max_speed"_a, "witnesses"_a, "threads"_a = 0);
  m.def("surface_layers", &surface_layers, "K"_a, "width"_a, "height"_a, "fixed"_a, "moving"_a,
        "max_speed"_a, "witnesses"_a, "depth"_a, "threads"_a = 0);
  m.def("splat_layers", &splat_layers, "K"_a, "width"_a, "height"_a, "static_frames"_a,
        "dynamic_frames"_a, "static_size"_a, "dynamic_size"_a, "depth"_a, "threads"_a = 0);
  m.def("render_splats", &splats, "K"_a, "width"_a, "height"_a, "static_frames"_a,
        "dynamic_frames"_a, "static_size"_a, "dynamic_size"_a, "threads"_a = 0);
}

}  // namespace docdepth::bindings
