#include <pybind11/stl.h>

#include <memory>

#include "arrays.hpp"
#include "docdepth/objects/classification.hpp"
#include "docdepth/objects/clustering.hpp"
#include "docdepth/objects/detections.hpp"
#include "docdepth/objects/tracking.hpp"

PYBIND11_MAKE_OPAQUE(docdepth::Detections)

namespace docdepth::bindings {
namespace {

/// The object of each point, as the row of its first point, which comes before or at the point.
const std::uint32_t* as_objects(const Array<std::uint32_t>& array, py::ssize_t size) {
  const std::uint32_t* objects = as_column(array, size, "objects");
  for (py::ssize_t i = 0; i < size; ++i)
    if (objects[i] > i || objects[objects[i]] != objects[i])
      throw std::invalid_argument("objects must be what cluster_objects made of these points");
  return objects;
}

/// Boxes as low and high corners, (K, 6).
std::vector<Extent> as_boxes(const Array<float>& array) {
  if (array.ndim() != 2 || array.shape(1) != 6)
    throw std::invalid_argument("boxes are low and high corners, (K, 6)");
  std::vector<Extent> boxes(array.shape(0));
  for (std::size_t k = 0; k < boxes.size(); ++k) {
    boxes[k].low = Eigen::Map<const Eigen::Vector3f>(array.data() + 6 * k);
    boxes[k].high = Eigen::Map<const Eigen::Vector3f>(array.data() + 6 * k + 3);
  }
  check_coordinates(array, "boxes");
  return boxes;
}

void append_box(const Extent& box, std::vector<float>& corners) {
  for (const auto* corner : {&box.low, &box.high})
    corners.insert(corners.end(), corner->data(), corner->data() + 3);
}

/// The points of a sweep and what is known about each, checked.
struct VotedSweep {
  PointMap points;
  const bool* ground;
  const std::uint16_t *static_votes, *dynamic_votes;

  VotedSweep(const Array<float>& rows, const Array<bool>& is_ground,
             const Array<std::uint16_t>& statics, const Array<std::uint16_t>& dynamics)
      : points(as_points(rows)),
        ground(as_flags(is_ground, points.rows(), "ground")),
        static_votes(as_column(statics, points.rows(), "static_votes")),
        dynamic_votes(as_column(dynamics, points.rows(), "dynamic_votes")) {}
};

std::vector<std::uint8_t> copy_flags(const Array<bool>& array, py::ssize_t size, const char* name) {
  const bool* flags = as_flags(array, size, name);
  return {flags, flags + size};
}

py::array_t<std::uint32_t> objects_of(const Array<float>& points, const Array<bool>& ground,
                                      const ScanMesh& mesh, const ObjectParameters& parameters) {
  const PointMap map = as_points(points);
  check_mesh(mesh, map.rows());
  const bool* flags = as_flags(ground, map.rows(), "ground");
  const ObjectParameters used = checked(parameters);
  std::vector<std::uint32_t> objects;
  {
    const py::gil_scoped_release release;
    objects = cluster_objects(map, flags, mesh, used);
  }
  return to_numpy(std::move(objects), {static_cast<py::ssize_t>(map.rows())});
}

py::array_t<std::uint8_t> classified(const Array<float>& points, const Array<bool>& ground,
                                     const Array<std::uint32_t>& objects,
                                     const Array<std::uint16_t>& static_votes,
                                     const Array<std::uint16_t>& dynamic_votes,
                                     const ScanMesh& mesh, const ObjectParameters& parameters) {
  const VotedSweep sweep(points, ground, static_votes, dynamic_votes);
  check_mesh(mesh, sweep.points.rows());
  const std::uint32_t* first = as_objects(objects, sweep.points.rows());
  const ObjectParameters used = checked(parameters);
  std::vector<std::uint8_t> dynamic;
  {
    const py::gil_scoped_release release;
    dynamic = classify_objects(sweep.points, sweep.ground, first, sweep.static_votes,
                               sweep.dynamic_votes, mesh, used);
  }
  return to_numpy(std::move(dynamic), {static_cast<py::ssize_t>(sweep.points.rows())});
}

py::array_t<std::uint8_t> with_isolated(const Array<float>& points, const Array<bool>& ground,
                                        const Array<std::uint32_t>& objects,
                                        const Array<std::uint16_t>& static_votes,
                                        const Array<std::uint16_t>& dynamic_votes,
                                        const Array<bool>& dynamic,
                                        const ObjectParameters& parameters) {
  const VotedSweep sweep(points, ground, static_votes, dynamic_votes);
  const std::uint32_t* first = as_objects(objects, sweep.points.rows());
  const ObjectParameters used = checked(parameters);
  std::vector<std::uint8_t> result = copy_flags(dynamic, sweep.points.rows(), "dynamic");
  {
    const py::gil_scoped_release release;
    add_isolated_points(sweep.points, sweep.ground, first, sweep.static_votes, sweep.dynamic_votes,
                        used, result);
  }
  return to_numpy(std::move(result), {static_cast<py::ssize_t>(sweep.points.rows())});
}

py::array_t<std::uint8_t> with_inside(const Array<float>& points, const Array<bool>& ground,
                                      const Array<std::uint16_t>& static_votes,
                                      const Array<std::uint16_t>& dynamic_votes,
                                      const Array<double>& pose, const Array<float>& boxes,
                                      const Array<std::uint64_t>& voxels,
                                      const Array<bool>& dynamic,
                                      const ObjectParameters& parameters) {
  const VotedSweep sweep(points, ground, static_votes, dynamic_votes);
  const Pose T_world_lidar = as_pose(pose);
  const std::vector<Extent> extents = as_boxes(boxes);
  const std::vector<std::uint64_t> sorted(voxels.data(), voxels.data() + voxels.size());
  const ObjectParameters used = checked(parameters);
  std::vector<std::uint8_t> result = copy_flags(dynamic, sweep.points.rows(), "dynamic");
  {
    const py::gil_scoped_release release;
    add_points_inside(sweep.points, sweep.ground, sweep.static_votes, sweep.dynamic_votes,
                      T_world_lidar, extents, sorted, used, result);
  }
  return to_numpy(std::move(result), {static_cast<py::ssize_t>(sweep.points.rows())});
}

std::unique_ptr<Detections> make_detections(const Array<float>& points, const Array<bool>& ground,
                                            const Array<std::uint32_t>& objects,
                                            const Array<bool>& dynamic, const Array<double>& pose) {
  const PointMap map = as_points(points);
  const bool* flags = as_flags(ground, map.rows(), "ground");
  const std::uint32_t* first = as_objects(objects, map.rows());
  const bool* moves = as_flags(dynamic, map.rows(), "dynamic");
  check_coordinates(points, "points of objects");
  const Pose T_world_lidar = as_pose(pose);
  const py::gil_scoped_release release;
  return std::make_unique<Detections>(detect_objects(map, flags, first, moves, T_world_lidar));
}

/// Detections as arrays: per object its first row, its points, how many of them are dynamic and
/// how many sampled points it has, (K, 4); its box, (K, 6); all sampled points, (M, 3).
py::tuple arrays_of(const Detections& detections) {
  const auto count = static_cast<py::ssize_t>(detections.size());
  std::vector<std::uint32_t> numbers;
  std::vector<float> boxes, samples;
  for (const Detection& object : detections) {
    numbers.insert(numbers.end(), {object.first, object.points, object.dynamic,
                                   static_cast<std::uint32_t>(object.samples.size())});
    append_box(object.box, boxes);
    for (const auto& point : object.samples)
      samples.insert(samples.end(), point.data(), point.data() + 3);
  }
  const auto all = static_cast<py::ssize_t>(samples.size() / 3);
  return py::make_tuple(to_numpy(std::move(numbers), {count, 4}),
                        to_numpy(std::move(boxes), {count, 6}),
                        to_numpy(std::move(samples), {all, 3}));
}

std::unique_ptr<Detections> detections_of(const Array<std::uint32_t>& numbers,
                                          const Array<float>& boxes, const Array<float>& samples) {
  const PointMap all = as_points(samples);
  check_coordinates(samples, "samples");
  if (numbers.ndim() != 2 || numbers.shape(1) != 4 || boxes.ndim() != 2 || boxes.shape(1) != 6 ||
      boxes.shape(0) != numbers.shape(0))
    throw std::invalid_argument(
        "detections are numbers (K, 4), boxes (K, 6) and sampled points (M, 3)");
  const std::vector<Extent> extents = as_boxes(boxes);
  auto detections = std::make_unique<Detections>(extents.size());
  Eigen::Index row = 0;
  for (std::size_t k = 0; k < extents.size(); ++k) {
    Detection& object = (*detections)[k];
    const std::uint32_t* n = numbers.data() + 4 * k;
    object.first = n[0], object.points = n[1], object.dynamic = n[2];
    object.box = extents[k];
    if (n[3] == 0 || row + n[3] > all.rows())
      throw std::invalid_argument("there are fewer sampled points than the detections say");
    for (const Eigen::Index end = row + n[3]; row < end; ++row)
      object.samples.push_back(all.row(row).transpose());
  }
  return detections;
}

/// A tuple a sweep: rows of dynamic objects, boxes of moving objects, dynamic voxels.
py::list track(const std::vector<const Detections*>& detections, const Array<double>& times,
               const TrackParameters& parameters, int threads) {
  const auto count = static_cast<py::ssize_t>(detections.size());
  const double* t = as_column(times, count, "times");
  for (const Detections* sweep : detections)
    if (!sweep) throw std::invalid_argument("tracking needs the detections of each sweep");
  for (py::ssize_t i = 0; i < count; ++i) in_range(t[i], -1e12, 1e12, "a time in seconds");
  const TrackParameters used = checked(parameters);
  threads = checked_threads(threads);
  std::vector<TrackingResult> tracked;
  {
    const py::gil_scoped_release release;
    tracked = track_objects(detections, {t, t + count}, used, threads);
  }
  py::list result;
  for (TrackingResult& sweep : tracked) {
    std::vector<float> corners;
    for (const Extent& box : sweep.boxes) append_box(box, corners);
    const auto objects = static_cast<py::ssize_t>(sweep.objects.size()),
               boxes = static_cast<py::ssize_t>(sweep.boxes.size()),
               voxels = static_cast<py::ssize_t>(sweep.voxels.size());
    result.append(py::make_tuple(to_numpy(std::move(sweep.objects), {objects}),
                                 to_numpy(std::move(corners), {boxes, 6}),
                                 to_numpy(std::move(sweep.voxels), {voxels})));
  }
  return result;
}

void bind_parameters(py::module_& m) {
  py::class_<ObjectParameters>(m, "ObjectParameters")
      .def(py::init<>())
      .def_readwrite("cluster_distance", &ObjectParameters::cluster_distance)
      .def_readwrite("cluster_distance_growth", &ObjectParameters::cluster_distance_growth)
      .def_readwrite("min_cluster_size", &ObjectParameters::min_cluster_size)
      .def_readwrite("neighbor_radius", &ObjectParameters::neighbor_radius)
      .def_readwrite("clear_votes", &ObjectParameters::clear_votes)
      .def_readwrite("clear_ratio", &ObjectParameters::clear_ratio)
      .def_readwrite("min_object_points", &ObjectParameters::min_object_points)
      .def_readwrite("dynamic_share", &ObjectParameters::dynamic_share)
      .def_readwrite("min_dynamic_share", &ObjectParameters::min_dynamic_share)
      .def_readwrite("min_object_width", &ObjectParameters::min_object_width)
      .def_readwrite("min_object_height", &ObjectParameters::min_object_height)
      .def_readwrite("observed_free_share", &ObjectParameters::observed_free_share)
      .def_readwrite("observed_free_votes", &ObjectParameters::observed_free_votes)
      .def_readwrite("max_static_ratio", &ObjectParameters::max_static_ratio)
      .def_readwrite("isolated_votes", &ObjectParameters::isolated_votes);
  py::class_<TrackParameters>(m, "TrackParameters")
      .def(py::init<>())
      .def_readwrite("min_detections", &TrackParameters::min_detections)
      .def_readwrite("min_distance", &TrackParameters::min_distance)
      .def_readwrite("max_speed", &TrackParameters::max_speed)
      .def_readwrite("max_gap", &TrackParameters::max_gap)
      .def_readwrite("max_gap_standing", &TrackParameters::max_gap_standing)
      .def_readwrite("window", &TrackParameters::window);
}

}  // namespace

void bind_objects(py::module_& m) {
  using namespace py::literals;
  bind_parameters(m);
  m.def("cluster_objects", &objects_of, "points"_a, "ground"_a, "mesh"_a, "parameters"_a);
  m.def("classify_objects", &classified, "points"_a, "ground"_a, "objects"_a, "static_votes"_a,
        "dynamic_votes"_a, "mesh"_a, "parameters"_a);
  m.def("add_isolated_points", &with_isolated, "points"_a, "ground"_a, "objects"_a,
        "static_votes"_a, "dynamic_votes"_a, "dynamic"_a, "parameters"_a);
  m.def("add_points_inside", &with_inside, "points"_a, "ground"_a, "static_votes"_a,
        "dynamic_votes"_a, "T_world_lidar"_a, "boxes"_a, "voxels"_a, "dynamic"_a, "parameters"_a);
  py::class_<Detections>(m, "Detections")
      .def(py::init(&make_detections), "points"_a, "ground"_a, "objects"_a, "dynamic"_a,
           "T_world_lidar"_a)
      .def_static("of", &detections_of, "numbers"_a, "boxes"_a, "samples"_a)
      .def_property_readonly("arrays", &arrays_of);
  m.def("track_objects", &track, "detections"_a, "times"_a, "parameters"_a, "threads"_a = 0);
}

}  // namespace docdepth::bindings
