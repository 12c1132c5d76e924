#include <pybind11/stl.h>

#include <memory>
#include <optional>

#include "arrays.hpp"
#include "docdepth/detections/classification.hpp"
#include "docdepth/detections/clustering.hpp"
#include "docdepth/detections/detections.hpp"
#include "docdepth/evidence/points_inside.hpp"
#include "docdepth/evidence/track_objects.hpp"

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
std::vector<Extent> as_extents(const Array<float>& array) {
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

constexpr py::ssize_t kBoxValues = 15;  // T_box_world, row after row, and half of the size
using Rows3x4 = Eigen::Matrix<float, 3, 4, Eigen::RowMajor>;

std::vector<OrientedBox> as_oriented_boxes(const Array<float>& array) {
  if (array.ndim() != 2 || array.shape(1) != kBoxValues)
    throw std::invalid_argument("boxes are T_box_world (3, 4) and half of the size, (K, 15)");
  check_coordinates(array, "boxes");
  std::vector<OrientedBox> boxes;
  for (py::ssize_t k = 0; k < array.shape(0); ++k) {
    const float* values = array.data() + kBoxValues * k;
    OrientedBox box{Eigen::Isometry3f::Identity(), Eigen::Map<const Eigen::Vector3f>(values + 12)};
    box.T_box_world.affine() = Eigen::Map<const Rows3x4>(values);
    boxes.push_back(box);
  }
  return boxes;
}

void append_oriented_box(const OrientedBox& box, std::vector<float>& values) {
  const Rows3x4 rows = box.T_box_world.affine();
  values.insert(values.end(), rows.data(), rows.data() + rows.size());
  values.insert(values.end(), box.half.data(), box.half.data() + 3);
}

void append(const Eigen::Vector3f& vector, std::vector<float>& values) {
  values.insert(values.end(), vector.data(), vector.data() + 3);
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
  std::vector<std::uint32_t> objects;
  {
    const py::gil_scoped_release release;
    objects = cluster_objects(map, flags, mesh, parameters);
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
  std::vector<std::uint8_t> dynamic;
  {
    const py::gil_scoped_release release;
    dynamic = classify_objects(sweep.points, sweep.ground, first, sweep.static_votes,
                               sweep.dynamic_votes, mesh, parameters);
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
  std::vector<std::uint8_t> result = copy_flags(dynamic, sweep.points.rows(), "dynamic");
  {
    const py::gil_scoped_release release;
    add_isolated_points(sweep.points, sweep.ground, first, sweep.static_votes, sweep.dynamic_votes,
                        parameters, result);
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
  const std::vector<OrientedBox> oriented = as_oriented_boxes(boxes);
  const std::vector<std::uint64_t> sorted(voxels.data(), voxels.data() + voxels.size());
  std::vector<std::uint8_t> result = copy_flags(dynamic, sweep.points.rows(), "dynamic");
  {
    const py::gil_scoped_release release;
    add_points_inside(sweep.points, sweep.ground, sweep.static_votes, sweep.dynamic_votes,
                      T_world_lidar, oriented, sorted, parameters, result);
  }
  return to_numpy(std::move(result), {static_cast<py::ssize_t>(sweep.points.rows())});
}

std::shared_ptr<Detections> make_detections(const Array<float>& points, const Array<bool>& ground,
                                            const Array<std::uint32_t>& objects,
                                            const Array<bool>& dynamic, const Array<bool>& one_stay,
                                            const Array<std::int32_t>& first_occupied,
                                            const Array<std::int32_t>& last_occupied,
                                            const ScanMesh& mesh, const Array<double>& pose,
                                            const std::optional<Array<float>>& time_offset) {
  const PointMap map = as_points(points);
  const auto count = map.rows();
  check_mesh(mesh, count);
  const PointEvidence evidence{
      as_flags(ground, count, "ground"),
      as_objects(objects, count),
      as_flags(dynamic, count, "dynamic"),
      as_flags(one_stay, count, "one_stay"),
      as_column(first_occupied, count, "first_occupied"),
      as_column(last_occupied, count, "last_occupied"),
      time_offset ? as_column(*time_offset, count, "time_offset") : nullptr};
  check_coordinates(points, "points of objects");
  const Pose T_world_lidar = as_pose(pose);
  const py::gil_scoped_release release;
  return std::make_shared<Detections>(detect_objects(map, evidence, mesh, T_world_lidar));
}

/// Detections as arrays: per object its first row, its points, how many of them are dynamic, how
/// many samples it has, when its place was occupied first and last, how many edges and hidden
/// borders it has, and since and until when it stands there, (K, 10); its area, that of its dynamic
/// points and that of free places, its time offset, its middle, the height of the ground and its
/// deviation, (K, 9); its box, (K, 6); all samples, (M, 3); their normals, (M, 3); the edges and
/// hidden borders of each object, (B, 3); when each sample, and then each border, was measured,
/// (M + B,).
py::tuple arrays_of(const Detections& detections) {
  const auto count = static_cast<py::ssize_t>(detections.size());
  std::vector<std::uint32_t> numbers;
  std::vector<float> areas, boxes, samples, normals, borders, times, border_times;
  for (const Detection& object : detections) {
    numbers.insert(numbers.end(), {object.first, object.points, object.dynamic,
                                   static_cast<std::uint32_t>(object.samples().size()),
                                   static_cast<std::uint32_t>(object.first_occupied),
                                   static_cast<std::uint32_t>(object.last_occupied),
                                   static_cast<std::uint32_t>(object.edges.points.size()),
                                   static_cast<std::uint32_t>(object.hidden.points.size()),
                                   static_cast<std::uint32_t>(object.stands_since),
                                   static_cast<std::uint32_t>(object.stands_until)});
    areas.insert(areas.end(),
                 {object.area, object.dynamic_area, object.free_area, object.time_offset});
    append(object.middle, areas);
    areas.insert(areas.end(), {object.ground.value, object.ground.deviation});
    append(object.box.low, boxes), append(object.box.high, boxes);
    for (const auto& point : object.samples()) append(point, samples);
    for (const auto& normal : object.surface.normals) append(normal, normals);
    times.insert(times.end(), object.surface.times.begin(), object.surface.times.end());
    for (const TimedPoints* border : {&object.edges, &object.hidden}) {
      for (const auto& point : border->points) append(point, borders);
      border_times.insert(border_times.end(), border->times.begin(), border->times.end());
    }
  }
  times.insert(times.end(), border_times.begin(), border_times.end());
  const auto all = static_cast<py::ssize_t>(samples.size() / 3),
             at_borders = static_cast<py::ssize_t>(borders.size() / 3);
  return py::make_tuple(
      to_numpy(std::move(numbers), {count, 10}), to_numpy(std::move(areas), {count, 9}),
      to_numpy(std::move(boxes), {count, 6}), to_numpy(std::move(samples), {all, 3}),
      to_numpy(std::move(normals), {all, 3}), to_numpy(std::move(borders), {at_borders, 3}),
      to_numpy(std::move(times), {all + at_borders}));
}

/// Take points and their times off the front of the rest of an array.
void take(const PointMap& points, const float* times, Eigen::Index& row, std::uint32_t count,
          TimedPoints& into) {
  if (row + count > points.rows())
    throw std::invalid_argument("there are fewer samples than the detections say");
  for (const Eigen::Index end = row + count; row < end; ++row)
    into.add(points.row(row).transpose(), times[row]);
}

std::shared_ptr<Detections> detections_of(const Array<std::uint32_t>& numbers,
                                          const Array<float>& areas, const Array<float>& boxes,
                                          const Array<float>& samples, const Array<float>& normals,
                                          const Array<float>& borders,
                                          const Array<float>& sample_times) {
  const PointMap all = as_points(samples), directions = as_points(normals, "normals"),
                 around = as_points(borders, "borders");
  check_coordinates(samples, "samples");
  check_coordinates(normals, "normals");
  check_coordinates(borders, "borders");
  const std::vector<Extent> extents = as_extents(boxes);
  const auto count = static_cast<py::ssize_t>(extents.size());
  const auto is_table = [&](const auto& array, py::ssize_t columns) {
    return array.ndim() == 2 && array.shape(0) == count && array.shape(1) == columns;
  };
  if (!is_table(numbers, 10) || !is_table(areas, 9) || directions.rows() != all.rows())
    throw std::invalid_argument(
        "detections are numbers (K, 10), areas (K, 9), boxes (K, 6), samples and normals (M, 3)");
  const float* times = as_column(sample_times, all.rows() + around.rows(), "sample_times");
  const float* border_times = times + all.rows();
  auto detections = std::make_shared<Detections>(extents.size());
  Eigen::Index row = 0, border = 0;
  for (std::size_t k = 0; k < extents.size(); ++k) {
    Detection& object = (*detections)[k];
    const std::uint32_t* n = numbers.data() + 10 * k;
    const float* a = areas.data() + 9 * k;
    object.first = n[0], object.points = n[1], object.dynamic = n[2];
    object.area = a[0], object.dynamic_area = a[1], object.free_area = a[2];
    object.first_occupied = std::int32_t(n[4]), object.last_occupied = std::int32_t(n[5]);
    object.stands_since = std::int32_t(n[8]), object.stands_until = std::int32_t(n[9]);
    object.time_offset = a[3], object.middle = {a[4], a[5], a[6]};
    object.ground = {a[7], a[8]};
    object.box = extents[k];
    if (n[1] == 0 || n[3] == 0) throw std::invalid_argument("a detection has points and samples");
    for (std::uint32_t i = 0; i < n[3] && row + i < all.rows(); ++i)
      object.surface.normals.push_back(directions.row(row + i).transpose());
    TimedPoints surface;
    take(all, times, row, n[3], surface);
    object.surface.points = std::move(surface.points);
    object.surface.times = std::move(surface.times);
    take(around, border_times, border, n[6], object.edges);
    take(around, border_times, border, n[7], object.hidden);
  }
  return detections;
}

py::tuple sweep_of(const TrackedSweep& sweep) {
  std::vector<std::uint32_t> members, tracks;
  std::vector<float> boxes;
  for (const Member& member : sweep.members)
    members.insert(members.end(), {member.first, member.track, std::uint32_t(member.dynamic)});
  for (const TrackBox& box : sweep.boxes) {
    tracks.insert(tracks.end(), {box.track, std::uint32_t(box.moving)});
    append_oriented_box(box.box, boxes);
  }
  const auto rows = static_cast<py::ssize_t>(sweep.members.size()),
             count = static_cast<py::ssize_t>(sweep.boxes.size()),
             voxels = static_cast<py::ssize_t>(sweep.voxels.size());
  return py::make_tuple(to_numpy(std::move(members), {rows, 3}),
                        to_numpy(std::move(tracks), {count, 2}),
                        to_numpy(std::move(boxes), {count, kBoxValues}),
                        to_numpy(std::vector<std::uint64_t>(sweep.voxels), {voxels}));
}

py::tuple object_of(const TrackedObject& object) {
  std::vector<std::int64_t> sweeps, points;
  std::vector<double> poses, velocities, deviations, surface_deviations;
  for (const auto& place : object.places) {
    sweeps.push_back(place.sweep), points.push_back(place.points);
    const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> T = place.T_world_object.matrix();
    poses.insert(poses.end(), T.data(), T.data() + T.size());
    velocities.insert(velocities.end(), place.velocity.data(), place.velocity.data() + 3);
    deviations.push_back(place.deviation);
    surface_deviations.push_back(place.surface_deviation);
  }
  const auto count = static_cast<py::ssize_t>(object.places.size());
  const std::vector<double> size{object.size.x(), object.size.y(), object.size.z()};
  return py::make_tuple(
      to_numpy(std::move(sweeps), {count}), to_numpy(std::move(points), {count}),
      to_numpy(std::move(poses), {count, 4, 4}), to_numpy(std::move(velocities), {count, 3}),
      to_numpy(std::move(deviations), {count}), to_numpy(std::move(surface_deviations), {count}),
      to_numpy(std::vector<double>(size), {3}), object.rigid);
}

/// Calls `take` with a tuple for each sweep in order: members (first row, track, whether it becomes
/// dynamic), tracks of boxes and whether they move, boxes, dynamic voxels. Returns a tuple a track:
/// sweeps, points, poses, velocities, two deviations, size, whether it is rigid. `read` gives the
/// detections of a sweep, and is asked for each several times; `held` sweeps are in memory at once.
py::list track(const py::function& read, const Array<double>& times,
               const TrackParameters& parameters, int threads, const py::function& take,
               py::ssize_t held) {
  const auto count = times.size();
  const double* t = as_column(times, count, "times");
  for (py::ssize_t i = 0; i < count; ++i) {
    in_range(t[i], -1e12, 1e12, "a time in seconds");
    if (i > 0 && !(t[i] > t[i - 1])) throw std::invalid_argument("times must increase");
  }
  if (held < 1) throw std::invalid_argument("at least one sweep must be held");
  const auto detections = [&](std::size_t sweep) -> std::shared_ptr<const Detections> {
    const py::gil_scoped_acquire acquire;
    auto found = read(sweep).cast<std::shared_ptr<Detections>>();
    if (!found) throw std::invalid_argument("tracking needs the detections of each sweep");
    return found;
  };
  const auto give = [&](const TrackedSweep& sweep) {
    const py::gil_scoped_acquire acquire;
    take(sweep_of(sweep));
  };
  std::vector<TrackedObject> tracked;
  {
    const py::gil_scoped_release release;
    tracked =
        track_objects(detections, {t, t + count}, parameters, threads, give, std::size_t(held));
  }
  py::list objects;
  for (TrackedObject& object : tracked) {
    objects.append(object_of(object));
    object = {};
  }
  return objects;
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
  py::class_<Detections, std::shared_ptr<Detections>>(m, "Detections")
      .def(py::init(&make_detections), "points"_a, "ground"_a, "objects"_a, "dynamic"_a,
           "one_stay"_a, "first_occupied"_a, "last_occupied"_a, "mesh"_a, "T_world_lidar"_a,
           "time_offset"_a = py::none())
      .def_static("of", &detections_of, "numbers"_a, "areas"_a, "extents"_a, "samples"_a,
                  "normals"_a, "borders"_a, "sample_times"_a)
      .def_property_readonly("arrays", &arrays_of);
  m.def("track_objects", &track, "read"_a, "times"_a, "parameters"_a, "threads"_a, "take"_a,
        "held"_a);
}

}  // namespace docdepth::bindings
