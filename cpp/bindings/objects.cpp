#include "objects.hpp"

#include <pybind11/stl.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <optional>

#include "arrays.hpp"
#include "docdepth/detections/classification.hpp"
#include "docdepth/detections/clustering.hpp"
#include "docdepth/evidence/points_inside.hpp"

namespace docdepth::bindings {
namespace {

// Rows of the structured arrays that cross the border: fields of four bytes, so
// without gaps.

/// A detection, without its samples and borders.
struct DetectionRow {
  std::uint32_t first, points, dynamic_points;
  std::uint32_t samples, edges, hidden;  ///< how many of them it has
  std::int32_t first_occupied, last_occupied, stands_since, stands_until;
  float area, dynamic_area, free_area, porous_area, time_offset;
  std::array<float, 3> middle;
  float ground_height, ground_deviation;
  std::array<float, 3> low, high;
};

struct SampleRow {
  std::array<float, 3> point, normal;
  float time;
};

struct BorderRow {
  std::array<float, 3> point;
  float time;
};

Eigen::Vector3f as_vector(const std::array<float, 3>& values) {
  const Eigen::Vector3f vector(values[0], values[1], values[2]);
  if (!(vector.array().abs() < kMaxRange).all())
    throw std::invalid_argument("coordinates must be finite and below 1e6 m");
  return vector;
}

/// Assign the values that a detection and its row have in common, one way or
/// the other.
template <class Row, class Object, class Assign>
void assign_values(Row& row, Object& object, const Assign& assign) {
  assign(row.first, object.first);
  assign(row.points, object.points);
  assign(row.dynamic_points, object.dynamic_points);
  assign(row.first_occupied, object.first_occupied);
  assign(row.last_occupied, object.last_occupied);
  assign(row.stands_since, object.stands_since);
  assign(row.stands_until, object.stands_until);
  assign(row.area, object.area);
  assign(row.dynamic_area, object.dynamic_area);
  assign(row.free_area, object.free_area);
  assign(row.porous_area, object.porous_area);
  assign(row.time_offset, object.time_offset);
  assign(row.ground_height, object.ground.value);
  assign(row.ground_deviation, object.ground.deviation);
}

/// One row after the other, checked for the end.
template <class Row>
class Rows {
 public:
  explicit Rows(const Array<Row>& array) : next_(array.data()), end_(next_ + array.size()) {}
  const Row& next() {
    if (next_ == end_) throw std::invalid_argument("there are fewer rows than the detections say");
    return *next_++;
  }

 private:
  const Row *next_, *end_;
};

/// The object of each point, as the row of its first point, which comes before
/// or at the point.
const std::uint32_t* as_object_column(const Array<std::uint32_t>& array, py::ssize_t size) {
  const std::uint32_t* objects = as_column(array, size, "objects");
  for (py::ssize_t i = 0; i < size; ++i)
    if (objects[i] > i || objects[objects[i]] != objects[i])
      throw std::invalid_argument("objects must be what cluster_objects made of these points");
  return objects;
}

std::vector<OrientedBox> as_oriented_boxes(const Array<BoxRow>& array) {
  std::vector<OrientedBox> boxes;
  for (py::ssize_t k = 0; k < array.size(); ++k) {
    const BoxRow& row = array.data()[k];
    OrientedBox box{Eigen::Isometry3f::Identity(), as_vector(row.half_size)};
    box.T_box_world.affine() = Eigen::Map<const Rows3x4>(row.T_box_world[0]);
    if (!(box.T_box_world.affine().array().abs() < kMaxRange).all())
      throw std::invalid_argument("boxes must be finite and below 1e6 m");
    boxes.push_back(box);
  }
  return boxes;
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
                                      const ScanMesh& mesh) {
  const PointMap map = as_points(points);
  check_mesh(mesh, map.rows());
  const bool* flags = as_flags(ground, map.rows(), "ground");
  return to_numpy(without_gil([&] { return cluster_objects(map, flags, mesh); }));
}

py::array_t<std::uint8_t> classified(const Array<float>& points, const Array<bool>& ground,
                                     const Array<std::uint32_t>& objects,
                                     const Array<std::uint16_t>& static_votes,
                                     const Array<std::uint16_t>& dynamic_votes,
                                     const Array<bool>& occupied_once, const ScanMesh& mesh,
                                     const ClassificationOptions& options) {
  const VotedSweep sweep(points, ground, static_votes, dynamic_votes);
  check_mesh(mesh, sweep.points.rows());
  const std::uint32_t* first = as_object_column(objects, sweep.points.rows());
  const bool* once = as_flags(occupied_once, sweep.points.rows(), "occupied_once");
  return to_numpy(without_gil([&] {
    return classify_objects(sweep.points, sweep.ground, first, sweep.static_votes,
                            sweep.dynamic_votes, once, mesh, options);
  }));
}

py::array_t<std::uint8_t> with_isolated(const Array<float>& points, const Array<bool>& ground,
                                        const Array<std::uint32_t>& objects,
                                        const Array<std::uint16_t>& static_votes,
                                        const Array<std::uint16_t>& dynamic_votes,
                                        const Array<bool>& dynamic) {
  const VotedSweep sweep(points, ground, static_votes, dynamic_votes);
  const std::uint32_t* first = as_object_column(objects, sweep.points.rows());
  std::vector<std::uint8_t> result = copy_flags(dynamic, sweep.points.rows(), "dynamic");
  without_gil([&] {
    add_isolated_points(sweep.points, sweep.ground, first, sweep.static_votes, sweep.dynamic_votes,
                        result);
  });
  return to_numpy(std::move(result));
}

py::array_t<std::uint8_t> with_inside(const Array<float>& points, const Array<bool>& ground,
                                      const Array<std::uint16_t>& static_votes,
                                      const Array<std::uint16_t>& dynamic_votes,
                                      const Array<double>& pose, const Array<BoxRow>& boxes,
                                      const Array<std::uint64_t>& voxels,
                                      const Array<bool>& dynamic) {
  const VotedSweep sweep(points, ground, static_votes, dynamic_votes);
  const Pose T_world_lidar = as_pose(pose);
  const std::vector<OrientedBox> oriented = as_oriented_boxes(boxes);
  const std::vector<std::uint64_t> sorted(voxels.data(), voxels.data() + voxels.size());
  std::vector<std::uint8_t> result = copy_flags(dynamic, sweep.points.rows(), "dynamic");
  without_gil([&] {
    add_points_inside(sweep.points, sweep.ground, sweep.static_votes, sweep.dynamic_votes,
                      T_world_lidar, oriented, sorted, result);
  });
  return to_numpy(std::move(result));
}

std::shared_ptr<Detections> make_detections(
    const Array<float>& points, const Array<bool>& ground, const Array<std::uint32_t>& objects,
    const Array<bool>& dynamic, const Array<bool>& occupied_once, const Array<bool>& porous,
    const Array<std::int32_t>& first_occupied, const Array<std::int32_t>& last_occupied,
    const ScanMesh& mesh, const Array<double>& pose,
    const std::optional<Array<float>>& time_offset) {
  const PointMap map = as_points(points);
  const auto count = map.rows();
  check_mesh(mesh, count);
  const PointEvidence evidence{
      as_flags(ground, count, "ground"),
      as_object_column(objects, count),
      as_flags(dynamic, count, "dynamic"),
      as_flags(occupied_once, count, "occupied_once"),
      as_flags(porous, count, "porous"),
      as_column(first_occupied, count, "first_occupied"),
      as_column(last_occupied, count, "last_occupied"),
      time_offset ? as_column(*time_offset, count, "time_offset") : nullptr};
  check_coordinates(points, "points of objects");
  const Pose T_world_lidar = as_pose(pose);
  const py::gil_scoped_release release;
  return std::make_shared<Detections>(detect_objects(map, evidence, mesh, T_world_lidar));
}

/// Detections as arrays of DetectionRow, SampleRow and BorderRow. Samples and
/// borders are those of one detection after the other; its edges come before
/// its hidden borders.
py::tuple arrays_of(const Detections& detections) {
  std::vector<DetectionRow> rows;
  std::vector<SampleRow> samples;
  std::vector<BorderRow> borders;
  for (const Detection& object : detections) {
    DetectionRow& row = rows.emplace_back();
    assign_values(row, object, [](auto& to, const auto& from) { to = from; });
    row.middle = as_array(object.middle);
    row.low = as_array(object.box.low);
    row.high = as_array(object.box.high);
    row.samples = static_cast<std::uint32_t>(object.samples().size());
    row.edges = static_cast<std::uint32_t>(object.edges.points.size());
    row.hidden = static_cast<std::uint32_t>(object.hidden.points.size());
    for (std::size_t i = 0; i < object.samples().size(); ++i)
      samples.push_back({as_array(object.samples()[i]), as_array(object.surface.normals[i]),
                         object.surface.times[i]});
    for (const TimedPoints* border : {&object.edges, &object.hidden})
      for (std::size_t i = 0; i < border->points.size(); ++i)
        borders.push_back({as_array(border->points[i]), border->times[i]});
  }
  return py::make_tuple(to_numpy(std::move(rows)), to_numpy(std::move(samples)),
                        to_numpy(std::move(borders)));
}

std::shared_ptr<Detections> detections_of(const Array<DetectionRow>& rows,
                                          const Array<SampleRow>& samples,
                                          const Array<BorderRow>& borders) {
  Rows<DetectionRow> objects(rows);
  Rows<SampleRow> surfaces(samples);
  Rows<BorderRow> ends(borders);
  auto detections = std::make_shared<Detections>(std::size_t(rows.size()));
  for (Detection& object : *detections) {
    const DetectionRow& row = objects.next();
    if (row.points == 0 || row.samples == 0)
      throw std::invalid_argument("a detection has points and samples");
    assign_values(row, object, [](const auto& from, auto& to) { to = from; });
    object.middle = Eigen::Map<const Eigen::Vector3f>(row.middle.data());
    object.box = {as_vector(row.low), as_vector(row.high)};
    for (std::uint32_t i = 0; i < row.samples; ++i) {
      const SampleRow& sample = surfaces.next();
      object.surface.add(as_vector(sample.point), as_vector(sample.normal), sample.time);
    }
    for (const auto& [border, count] :
         {std::pair(&object.edges, row.edges), std::pair(&object.hidden, row.hidden)})
      for (std::uint32_t i = 0; i < count; ++i) {
        const BorderRow& end = ends.next();
        border->add(as_vector(end.point), end.time);
      }
  }
  return detections;
}

void bind_rows() {
  PYBIND11_NUMPY_DTYPE(DetectionRow, first, points, dynamic_points, samples, edges, hidden,
                       first_occupied, last_occupied, stands_since, stands_until, area,
                       dynamic_area, free_area, porous_area, time_offset, middle, ground_height,
                       ground_deviation, low, high);
  PYBIND11_NUMPY_DTYPE(SampleRow, point, normal, time);
  PYBIND11_NUMPY_DTYPE(BorderRow, point, time);
  PYBIND11_NUMPY_DTYPE(BoxRow, track, is_moving, T_box_world, half_size);
}

void bind_options(py::module_& m) {
  using Options = ClassificationOptions;
  py::class_<Options>(m, "ClassificationOptions")
      .def(py::init<>())
      .def_readwrite("min_dynamic_share", &Options::min_dynamic_share)
      .def_readwrite("observed_free_share", &Options::observed_free_share)
      .def_readwrite("max_static_ratio", &Options::max_static_ratio);
}

}  // namespace

void bind_objects(py::module_& m) {
  using namespace py::literals;
  bind_rows();
  bind_options(m);
  m.def("cluster_objects", &objects_of, "points"_a, "ground"_a, "mesh"_a);
  m.def("classify_objects", &classified, "points"_a, "ground"_a, "objects"_a, "static_votes"_a,
        "dynamic_votes"_a, "occupied_once"_a, "mesh"_a, "options"_a = ClassificationOptions());
  m.def("add_isolated_points", &with_isolated, "points"_a, "ground"_a, "objects"_a,
        "static_votes"_a, "dynamic_votes"_a, "dynamic"_a);
  m.def("add_points_inside", &with_inside, "points"_a, "ground"_a, "static_votes"_a,
        "dynamic_votes"_a, "T_world_lidar"_a, "boxes"_a, "voxels"_a, "dynamic"_a);
  py::class_<Detections, std::shared_ptr<Detections>>(m, "Detections")
      .def(py::init(&make_detections), "points"_a, "ground"_a, "objects"_a, "dynamic"_a,
           "occupied_once"_a, "porous"_a, "first_occupied"_a, "last_occupied"_a, "mesh"_a,
           "T_world_lidar"_a, "time_offset"_a = py::none())
      .def_static("of", &detections_of, "rows"_a, "samples"_a, "borders"_a)
      .def_property_readonly("arrays", &arrays_of);
}

}  // namespace docdepth::bindings
