#include <pybind11/stl.h>

#include <memory>

#include "arrays.hpp"
#include "docdepth/dynamics/key_frame.hpp"
#include "docdepth/dynamics/objects.hpp"
#include "docdepth/dynamics/range_image.hpp"
#include "docdepth/dynamics/surface_image.hpp"

namespace docdepth::bindings {
namespace {

std::unique_ptr<RangeImage> make_range_image(const Array<float>& points, const Array<bool>& ground,
                                             double resolution, int window, float tolerance,
                                             bool plain) {
  const PointMap map = as_points(points);
  const bool* flags = as_column(ground, map.rows(), "ground");
  py::gil_scoped_release release;
  return std::make_unique<RangeImage>(map, flags,
                                      RangeImageParameters{resolution, window, tolerance, plain});
}

/// A surface of other points would be read beyond their end.
void check_surface(const Surface& surface, Eigen::Index rows) {
  if (surface.points != static_cast<std::size_t>(rows))
    throw std::invalid_argument("the surface was made of another number of points");
}

std::unique_ptr<SurfaceImage> make_surface_image(const Array<float>& points, const Surface& surface,
                                                 const SurfaceImageParameters& parameters) {
  const PointMap map = as_points(points);
  check_surface(surface, map.rows());
  py::gil_scoped_release release;
  return std::make_unique<SurfaceImage>(map, surface, parameters);
}

py::tuple vote_on(const Array<float>& points, const Array<bool>& ground,
                  const Array<double>& T_world_lidar,
                  const std::vector<const KeyFrame*>& key_frames, const Array<double>& poses,
                  int threads) {
  const PointMap map = as_points(points);
  const bool* flags = as_column(ground, map.rows(), "ground");
  const Pose pose = as_pose(T_world_lidar);
  const std::vector<Pose> T_world_key = as_poses(poses);
  Votes votes;
  {
    py::gil_scoped_release release;
    votes = vote(map, flags, pose, key_frames, T_world_key, threads);
  }
  const py::ssize_t count = map.rows();
  return py::make_tuple(to_numpy(std::move(votes.statics), {count}),
                        to_numpy(std::move(votes.dynamics), {count}));
}

py::array_t<std::uint8_t> moving(const Array<float>& points, const Array<bool>& ground,
                                 const Array<std::uint16_t>& statics,
                                 const Array<std::uint16_t>& dynamics, const Surface& surface,
                                 const ObjectParameters& parameters) {
  const PointMap map = as_points(points);
  check_surface(surface, map.rows());
  const bool* flags = as_column(ground, map.rows(), "ground");
  const std::uint16_t* s = as_column(statics, map.rows(), "statics");
  const std::uint16_t* d = as_column(dynamics, map.rows(), "dynamics");
  std::vector<std::uint8_t> result;
  {
    py::gil_scoped_release release;
    result = moving_points(map, flags, s, d, surface, parameters);
  }
  return to_numpy(std::move(result), {static_cast<py::ssize_t>(map.rows())});
}

}  // namespace

void bind_dynamics(py::module_& m) {
  py::class_<KeyFrame>(m, "KeyFrame");
  py::class_<RangeImage, KeyFrame>(m, "RangeImage")
      .def(py::init(&make_range_image), py::arg("points"), py::arg("ground"), py::arg("resolution"),
           py::arg("window"), py::arg("tolerance"), py::arg("plain") = false);
  py::class_<Margins>(m, "Margins")
      .def(py::init<float, float, float>(), py::arg("across"), py::arg("along"), py::arg("growth"));
  py::class_<SurfaceImageParameters>(m, "SurfaceImageParameters")
      .def(py::init<>())
      .def_readwrite("resolution", &SurfaceImageParameters::resolution)
      .def_readwrite("window", &SurfaceImageParameters::window)
      .def_readwrite("tolerance", &SurfaceImageParameters::tolerance)
      .def_readwrite("upright", &SurfaceImageParameters::upright)
      .def_readwrite("level", &SurfaceImageParameters::level)
      .def_readwrite("level_cosine", &SurfaceImageParameters::level_cosine)
      .def_readwrite("beam", &SurfaceImageParameters::beam);
  py::class_<ObjectParameters>(m, "ObjectParameters")
      .def(py::init<>())
      .def_readwrite("link", &ObjectParameters::link)
      .def_readwrite("link_growth", &ObjectParameters::link_growth)
      .def_readwrite("companions", &ObjectParameters::companions)
      .def_readwrite("company", &ObjectParameters::company)
      .def_readwrite("clear_votes", &ObjectParameters::clear_votes)
      .def_readwrite("clear_ratio", &ObjectParameters::clear_ratio)
      .def_readwrite("object_points", &ObjectParameters::object_points)
      .def_readwrite("share", &ObjectParameters::share)
      .def_readwrite("width", &ObjectParameters::width)
      .def_readwrite("freed_share", &ObjectParameters::freed_share)
      .def_readwrite("freed_votes", &ObjectParameters::freed_votes)
      .def_readwrite("freed_ratio", &ObjectParameters::freed_ratio);
  m.def("moving_points", &moving, py::arg("points"), py::arg("ground"), py::arg("statics"),
        py::arg("dynamics"), py::arg("surface"), py::arg("parameters"));
  py::class_<SurfaceImage, KeyFrame>(m, "SurfaceImage")
      .def(py::init(&make_surface_image), py::arg("points"), py::arg("surface"),
           py::arg("parameters"));
  m.def("vote", &vote_on, py::arg("points"), py::arg("ground"), py::arg("T_world_lidar"),
        py::arg("key_frames"), py::arg("poses"), py::arg("threads") = 0);
}

}  // namespace docdepth::bindings
