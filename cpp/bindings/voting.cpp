#include <pybind11/stl.h>

#include <memory>

#include "arrays.hpp"
#include "docdepth/voting/key_frame.hpp"
#include "docdepth/voting/mesh_image.hpp"
#include "docdepth/voting/range_image.hpp"

namespace docdepth::bindings {
namespace {

constexpr double kMinResolution = 5e-4;  ///< of a key frame [rad]: 2 GB at most
constexpr int kMaxWindow = 63;           ///< of a key frame [pixel]

void check_key_frame(double resolution, int window) {
  in_range(resolution, kMinResolution, 1, "resolution");
  in_range(window, 1, kMaxWindow, "window");
}

std::unique_ptr<RangeImage> make_range_image(const Array<float>& points, const Array<bool>& ground,
                                             double resolution, int window, float tolerance) {
  const PointMap map = as_points(points);
  const bool* flags = as_flags(ground, map.rows(), "ground");
  check_key_frame(resolution, window);
  const py::gil_scoped_release release;
  return std::make_unique<RangeImage>(map, flags,
                                      RangeImageParameters{resolution, window, tolerance});
}

std::unique_ptr<MeshImage> make_mesh_image(const Array<float>& points, const Array<bool>& ground,
                                           const ScanMesh& mesh,
                                           const MeshImageParameters& parameters) {
  const PointMap map = as_points(points);
  const bool* flags = as_flags(ground, map.rows(), "ground");
  check_mesh(mesh, map.rows());
  check_key_frame(parameters.resolution, parameters.window);
  const py::gil_scoped_release release;
  return std::make_unique<MeshImage>(map, flags, mesh, parameters);
}

py::tuple vote_on(const Array<float>& points, const Array<bool>& ground,
                  const Array<double>& T_world_lidar,
                  const std::vector<const KeyFrame*>& key_frames, const Array<double>& poses,
                  const std::vector<double>& seconds, int threads, bool coarse_first) {
  const PointMap map = as_points(points);
  const bool* flags = as_flags(ground, map.rows(), "ground");
  in_range(double(key_frames.size()), 0, Votes::kNever, "the number of key frames");
  const Pose pose = as_pose(T_world_lidar);
  const std::vector<Pose> T_world_key = as_poses(poses);
  for (const KeyFrame* key_frame : key_frames)
    if (!key_frame) throw std::invalid_argument("a key frame is None");
  Votes votes = without_gil([&] {
    return vote(map, flags, pose, key_frames, T_world_key, seconds, threads, coarse_first);
  });
  return py::make_tuple(to_numpy(std::move(votes.statics)), to_numpy(std::move(votes.dynamics)),
                        to_numpy(std::move(votes.occupied_once)), to_numpy(std::move(votes.porous)),
                        to_numpy(std::move(votes.first_occupied)),
                        to_numpy(std::move(votes.last_occupied)));
}

}  // namespace

void bind_voting(py::module_& m) {
  using namespace py::literals;
  py::class_<KeyFrame>(m, "KeyFrame");
  py::class_<RangeImage, KeyFrame>(m, "RangeImage")
      .def(py::init(&make_range_image), "points"_a, "ground"_a, "resolution"_a, "window"_a,
           "tolerance"_a);
  py::class_<MeshImageParameters>(m, "MeshImageParameters")
      .def(py::init<>())
      .def_readwrite("resolution", &MeshImageParameters::resolution)
      .def_readwrite("window", &MeshImageParameters::window)
      .def_readwrite("tolerance", &MeshImageParameters::tolerance)
      .def_readwrite("ground_tolerance", &MeshImageParameters::ground_tolerance)
      .def_readwrite("level_cosine", &MeshImageParameters::level_cosine)
      .def_readwrite("up", &MeshImageParameters::up);
  py::class_<MeshImage, KeyFrame>(m, "MeshImage")
      .def(py::init(&make_mesh_image), "points"_a, "ground"_a, "mesh"_a, "parameters"_a);
  m.def("vote", &vote_on, "points"_a, "ground"_a, "T_world_lidar"_a, "key_frames"_a, "poses"_a,
        "seconds"_a, "threads"_a = 0, "coarse_first"_a = false);
}

}  // namespace docdepth::bindings
