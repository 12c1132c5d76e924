#include <pybind11/stl.h>

#include <memory>
#include <optional>

#include "arrays.hpp"
#include "docdepth/render/camera.hpp"
#include "docdepth/render/cloud.hpp"
#include "docdepth/render/splats.hpp"
#include "docdepth/render/surfaces.hpp"

namespace docdepth::bindings {
namespace {

Camera as_camera(const Array<double>& K, int width, int height) {
  if (K.ndim() != 2 || K.shape(0) != 3 || K.shape(1) != 3 || width < 1 || height < 1)
    throw std::invalid_argument("K must be a float64 array of shape (3, 3), the size positive");
  return {K.at(0, 0), K.at(1, 1), K.at(0, 2), K.at(1, 2), width, height};
}

std::unique_ptr<Frame> make_frame(const Array<float>& points, const Array<std::uint16_t>& classid,
                                  double crop) {
  const PointMap map = as_points(points);
  const std::uint16_t* classes = as_column(classid, map.rows(), "classid");
  const py::gil_scoped_release release;
  return std::make_unique<Frame>(map, classes, crop);
}

using Placed = std::pair<const Frame*, Array<double>>;

void place(const std::vector<Placed>& frames, bool dynamic, const SplatHeights& heights,
           std::vector<PlacedCloud>& clouds) {
  for (const auto& [frame, pose] : frames)
    clouds.push_back(
        {dynamic ? &frame->dynamic_points : &frame->static_points, as_pose(pose), &heights});
}

py::array_t<float> splats(const Array<double>& K, int width, int height,
                          const std::vector<Placed>& static_frames,
                          const std::vector<Placed>& dynamic_frames,
                          std::pair<double, double> static_size,
                          std::pair<double, double> dynamic_size, int threads) {
  const Camera camera = as_camera(K, width, height);
  const SplatHeights static_heights({static_size.first, static_size.second});
  const SplatHeights dynamic_heights({dynamic_size.first, dynamic_size.second});
  std::vector<PlacedCloud> clouds;
  place(static_frames, false, static_heights, clouds);
  place(dynamic_frames, true, dynamic_heights, clouds);
  std::vector<float> depth;
  {
    const py::gil_scoped_release release;
    depth = render_splats(camera, clouds, threads);
  }
  return to_numpy(std::move(depth), {height, width});
}

std::unique_ptr<SurfaceFrame> make_surface_frame(
    const Array<float>& points, const Array<std::uint16_t>& classid,
    const Array<std::uint32_t>& triangles, const Array<std::uint8_t>& cut,
    const Array<std::uint32_t>& loose, float loose_angle, const std::optional<Array<float>>& late) {
  const PointMap map = as_points(points);
  const std::uint16_t* classes = as_column(classid, map.rows(), "classid");
  const py::ssize_t count = triangles.shape(0);
  const std::uint8_t* cuts = as_column(cut, count, "cut");
  const float* times = late ? as_column(*late, map.rows(), "late") : nullptr;
  const auto* corners = reinterpret_cast<const std::uint32_t (*)[3]>(triangles.data());
  const py::gil_scoped_release release;
  return std::make_unique<SurfaceFrame>(map, corners, cuts, count, loose.data(), loose.size(),
                                        loose_angle, classes, times);
}

using PlacedFrame = std::pair<const SurfaceFrame*, Array<double>>;

py::array_t<float> surfaces(const Array<double>& K, int width, int height,
                            const std::vector<PlacedFrame>& fixed, const PlacedFrame& nearest,
                            const PlacedFrame& other, float duration, float delay, float max_speed,
                            int threads) {
  const Camera camera = as_camera(K, width, height);
  const auto placed = [](const PlacedFrame& frame) {
    return PlacedSurface{frame.first, as_pose(frame.second)};
  };
  std::vector<PlacedSurface> world;
  for (const auto& frame : fixed) world.push_back(placed(frame));
  const Motion motion{placed(nearest), placed(other), duration, delay, max_speed};
  std::vector<float> depth;
  {
    const py::gil_scoped_release release;
    depth = render_surfaces(camera, world, motion, threads);
  }
  return to_numpy(std::move(depth), {height, width});
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
           "loose"_a, "loose_angle"_a, "late"_a = py::none());
  m.def("render_surfaces", &surfaces, "K"_a, "width"_a, "height"_a, "fixed"_a, "nearest"_a,
        "other"_a, "duration"_a, "delay"_a, "max_speed"_a, "threads"_a = 0);
  m.def("render_splats", &splats, "K"_a, "width"_a, "height"_a, "static_frames"_a,
        "dynamic_frames"_a, "static_size"_a, "dynamic_size"_a, "threads"_a = 0);
}

}  // namespace docdepth::bindings
