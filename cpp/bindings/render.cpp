#include "render.hpp"

#include <algorithm>
#include <limits>
#include <memory>
#include <optional>
#include <string>

#include "docdepth/render/beam_edges.hpp"
#include "docdepth/render/gl/renderer.hpp"
#include "docdepth/render/layers.hpp"
#include "docdepth/render/surface_normals.hpp"

namespace docdepth::bindings {
namespace {

using gl::GlRenderer;

std::unique_ptr<Frame> make_frame(const Array<float>& points, const Array<std::uint16_t>& classid,
                                  double crop) {
  const PointMap map = as_points(points);
  const std::uint16_t* classes = as_column(classid, map.rows(), "classid");
  in_range(crop, 0, std::numeric_limits<double>::infinity(), "crop");
  const py::gil_scoped_release release;
  return std::make_unique<Frame>(map, classes, crop);
}

/// Define render_splats, of which `draw` draws, on the module or on a class of
/// renderers.
template <class... Self, class Scope, class Draw>
void define_splats(Scope& scope, const Draw& draw) {
  using namespace py::literals;
  const auto render = [draw](Self... self, const Array<double>& K, int width, int height,
                             const std::vector<Placed>& static_frames,
                             const std::vector<Placed>& dynamic_frames, const Size& static_size,
                             const Size& dynamic_size, int threads) {
    const Camera camera = as_camera(K, width, height);
    const PlacedClouds placed(static_frames, dynamic_frames, static_size, dynamic_size);
    return to_numpy(without_gil([&] { return draw(self..., camera, placed, threads); }),
                    {height, width});
  };
  scope.def("render_splats", render, "K"_a, "width"_a, "height"_a, "static_frames"_a,
            "dynamic_frames"_a, "static_size"_a, "dynamic_size"_a, "threads"_a = 0);
}

/// Define render_meshes in the same way.
template <class... Self, class Scope, class Draw>
void define_meshes(Scope& scope, const Draw& draw) {
  using namespace py::literals;
  const auto render = [draw](Self... self, const Array<double>& K, int width, int height,
                             const std::vector<PlacedFrame>& static_frames,
                             const std::vector<ObjectOf>& objects, int visibility_sweeps,
                             int threads, const std::vector<ShutterOf>& shutter_sweeps,
                             const std::vector<BoxOf>& boxes, int nearest_frames) {
    const Camera camera = as_camera(K, width, height);
    const MeshScene scene = as_scene(camera, static_frames, objects, visibility_sweeps,
                                     shutter_sweeps, boxes, nearest_frames);
    return to_numpy(without_gil([&] { return draw(self..., camera, scene, threads); }),
                    {height, width});
  };
  scope.def("render_meshes", render, "K"_a, "width"_a, "height"_a, "static_frames"_a, "objects"_a,
            "visibility_sweeps"_a, "threads"_a = 0, "shutter_sweeps"_a = py::list(),
            "boxes"_a = py::list(), "nearest_frames"_a = 1);
}

/// The renderer of the processor.
std::vector<float> draw_splats(const Camera& camera, const PlacedClouds& placed, int threads) {
  // It keeps an image for each height of splats.
  const int largest = std::max(placed.static_heights.largest(), placed.dynamic_heights.largest());
  in_range(double(camera.width) * camera.height * largest, 0, kMaxSplatPixels,
           "the pixels of the image times the height of the largest splat");
  return render_splats(camera, placed.clouds, threads);
}

/// A row for each point; the points themselves if there are none.
PointMap rows_of(const std::optional<Array<float>>& rows, const PointMap& points,
                 const char* name) {
  const PointMap map = rows ? as_points(*rows, name) : points;
  if (map.rows() != points.rows())
    throw std::invalid_argument(std::string(name) + " must be as many as the points");
  return map;
}

std::unique_ptr<MeshFrame> make_mesh_frame(
    const Array<float>& points, const Array<std::uint16_t>& classid,
    const Array<std::uint32_t>& triangles, const Array<std::uint8_t>& discontinuity,
    const Array<std::uint32_t>& isolated, float isolated_angle,
    const Array<std::uint16_t>& object_index, const Array<float>& motion,
    const std::optional<Array<float>>& time_offset, const std::optional<Array<float>>& displacement,
    const std::optional<Array<float>>& ray_origins, const std::optional<Array<std::uint8_t>>& drawn,
    float widening) {
  const PointMap map = as_points(points);
  const Points from = rows_of(ray_origins, map, "ray_origins");
  const Points moved = rows_of(displacement, map, "displacement");
  const std::uint16_t* classes = as_column(classid, map.rows(), "classid");
  const std::uint16_t* object_indices = as_column(object_index, map.rows(), "object_index");
  const float* times = time_offset ? as_column(*time_offset, map.rows(), "time_offset") : nullptr;
  if (motion.ndim() != 2 || motion.shape(1) != 4)
    throw std::invalid_argument("motion must be a float32 array of shape (objects, 4)");
  in_range(double(motion.shape(0)), 0, 0xFFFF, "the number of objects");
  std::vector<ObjectMotion> motions;
  for (py::ssize_t k = 0; k < motion.shape(0); ++k)
    motions.push_back({{motion.at(k, 0), motion.at(k, 1), motion.at(k, 2)}, motion.at(k, 3)});
  std::uint16_t last = 0;
  for (py::ssize_t i = 0; i < map.rows(); ++i) last = std::max(last, object_indices[i]);
  in_range(last, 0, double(motions.size()), "an object_index");
  if (triangles.ndim() != 2 || triangles.shape(1) != 3)
    throw std::invalid_argument("triangles must be a uint32 array of shape (M, 3)");
  const py::ssize_t count = triangles.shape(0);
  const std::uint8_t* jumps = as_column(discontinuity, count, "discontinuity");
  const auto* corners =
      reinterpret_cast<const std::uint32_t (*)[3]>(as_rows(triangles, map.rows(), "triangles"));
  const std::uint32_t* alone = as_rows(isolated, map.rows(), "isolated");
  in_range(isolated_angle, 0, 1, "isolated_angle");
  in_range(widening, 0, 1, "widening");
  const std::uint8_t* shown = drawn ? as_column(*drawn, motion.shape(0), "drawn") : nullptr;
  const py::gil_scoped_release release;
  const Points measured = map;
  Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> narrowed;
  if (widening > 0) narrowed = narrow_beams(measured, corners, jumps, std::size_t(count), widening);
  const Points all = widening > 0 ? Points(narrowed) : measured;
  return std::make_unique<MeshFrame>(
      MeshParts{all, corners, jumps, std::size_t(count), alone, std::size_t(isolated.size()),
                isolated_angle, classes, object_indices, motions, shown, times,
                displacement ? &moved : nullptr, ray_origins ? &from : nullptr});
}

std::unique_ptr<Rays> make_rays(const Array<float>& points, const Array<float>& normals,
                                const std::optional<Array<float>>& ray_origins) {
  const PointMap map = as_points(points), directions = as_points(normals, "normals");
  const Points from = rows_of(ray_origins, map, "ray_origins");
  if (directions.rows() != map.rows())
    throw std::invalid_argument("normals must be as many as the points");
  const py::gil_scoped_release release;
  std::vector<Eigen::Vector3f> rows;
  for (Eigen::Index i = 0; i < map.rows(); ++i) rows.push_back(directions.row(i));
  return std::make_unique<Rays>(map, rows, ray_origins ? &from : nullptr);
}

py::array_t<float> query_visibility(const Rays& rays, const Array<float>& points) {
  const PointMap map = as_points(points);
  std::vector<float> score(map.rows(), 0.0f);
  without_gil([&] {
    PointBatch some;
    for (Eigen::Index first = 0; first < map.rows(); first += Eigen::Index(some.size)) {
      some.size = std::min<std::size_t>(map.rows() - first, PointBatch::kMax);
      for (std::size_t i = 0; i < some.size; ++i) {
        some.x[i] = map(first + i, 0);
        some.y[i] = map(first + i, 1);
        some.z[i] = map(first + i, 2);
      }
      rays.query_visibility(some, kRayBlur, score.data() + first);
    }
  });
  return to_numpy(std::move(score));
}

py::dict as_dict(Layers&& layers, int width, int height) {
  using namespace py::literals;
  const std::vector<py::ssize_t> shape{height, width};
  py::dict dict;
  if (!layers.normal.empty())
    dict["normal"] = to_numpy(std::move(layers.normal), {height, width, 3});
  if (!layers.seen.empty()) {
    std::vector<std::uint8_t> seen;
    for (const Seen state : layers.seen) seen.push_back(static_cast<std::uint8_t>(state));
    dict["seen"] = to_numpy(std::move(seen), shape);
  }
  dict["sweep"] = to_numpy(std::move(layers.sweep), shape);
  dict["class"] = to_numpy(std::move(layers.classid), shape);
  dict["instance"] = to_numpy(std::move(layers.instance), shape);
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

std::pair<py::array_t<float>, py::array_t<float>> fitted_normals(const Array<double>& K, int width,
                                                                 int height,
                                                                 const Array<float>& depth,
                                                                 const Array<float>& normals,
                                                                 int threads) {
  const Camera camera = as_camera(K, width, height);
  const float* z = as_depth(depth, width, height);
  if (normals.ndim() != 3 || normals.shape(0) != height || normals.shape(1) != width ||
      normals.shape(2) != 3)
    throw std::invalid_argument("normals must have shape (height, width, 3)");
  std::vector<float> fitted(normals.data(), normals.data() + normals.size());
  std::vector<float> leans =
      without_gil([&] { return fit_normals(camera, z, fitted.data(), threads); });
  return {to_numpy(std::move(fitted), {height, width, 3}),
          to_numpy(std::move(leans), {height, width})};
}

py::dict splat_layers(const Array<double>& K, int width, int height,
                      const std::vector<Placed>& static_frames,
                      const std::vector<Placed>& dynamic_frames, const Size& static_size,
                      const Size& dynamic_size, const Array<float>& depth, int threads) {
  const Camera camera = as_camera(K, width, height);
  const PlacedClouds placed(static_frames, dynamic_frames, static_size, dynamic_size);
  const float* z = as_depth(depth, width, height);
  return as_dict(without_gil([&] { return layers_of_splats(camera, placed.clouds, z, threads); }),
                 width, height);
}

py::dict mesh_layers(const Array<double>& K, int width, int height,
                     const std::vector<PlacedFrame>& static_frames,
                     const std::vector<ObjectOf>& objects, int visibility_sweeps,
                     const Array<float>& depth, int threads,
                     const std::vector<ShutterOf>& shutter_sweeps, bool seen) {
  const Camera camera = as_camera(K, width, height);
  const MeshScene scene =
      as_scene(camera, static_frames, objects, visibility_sweeps, shutter_sweeps);
  const float* z = as_depth(depth, width, height);
  return as_dict(without_gil([&] { return layers_of_triangles(camera, scene, z, seen, threads); }),
                 width, height);
}

std::unique_ptr<GlRenderer> open(const std::string& library, int device) {
  const py::gil_scoped_release release;
  return std::make_unique<GlRenderer>(library, device);
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
  py::class_<MeshFrame>(m, "MeshFrame")
      .def(py::init(&make_mesh_frame), "points"_a, "classid"_a, "triangles"_a, "discontinuity"_a,
           "isolated"_a, "isolated_angle"_a, "object_index"_a, "motion"_a,
           "time_offset"_a = py::none(), "displacement"_a = py::none(),
           "ray_origins"_a = py::none(), "drawn"_a = py::none(), "widening"_a = 0.0f);
  py::class_<Rays>(m, "Rays")
      .def(py::init(&make_rays), "points"_a, "normals"_a, "ray_origins"_a = py::none())
      .def("query_visibility", &query_visibility, "points"_a);
  define_meshes(m, &render_triangles);
  m.def("fit_normals", &fitted_normals, "K"_a, "width"_a, "height"_a, "depth"_a, "normals"_a,
        "threads"_a = 0);
  m.def("mesh_layers", &mesh_layers, "K"_a, "width"_a, "height"_a, "static_frames"_a, "objects"_a,
        "visibility_sweeps"_a, "depth"_a, "threads"_a = 0, "shutter_sweeps"_a = py::list(),
        "seen"_a = false);
  m.def("splat_layers", &splat_layers, "K"_a, "width"_a, "height"_a, "static_frames"_a,
        "dynamic_frames"_a, "static_size"_a, "dynamic_size"_a, "depth"_a, "threads"_a = 0);
  define_splats(m, &draw_splats);

  py::register_exception<gl::GlError>(m, "GlError",
                                      py::module_::import("docdepth.errors").attr("BackendError"));
  m.def("egl_devices", &gl::egl_devices);
  py::class_<GlRenderer> renderer(m, "GlRenderer");
  renderer.def(py::init(&open), "library"_a, "device"_a = -1)
      .def_property_readonly("renderer",
                             [](const GlRenderer& self) { return self.context().renderer(); });
  // The driver has its own threads. The argument makes this a drop-in for the
  // processor's renderer.
  define_splats<GlRenderer&>(
      renderer, [](GlRenderer& self, const Camera& camera, const PlacedClouds& placed, int) {
        return self.render_splats(camera, placed.clouds);
      });
  define_meshes<GlRenderer&>(
      renderer, [](GlRenderer& self, const Camera& camera, const MeshScene& scene, int) {
        return self.render_triangles(camera, scene);
      });
}

}  // namespace docdepth::bindings
