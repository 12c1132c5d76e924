#include <pybind11/stl.h>

#include <memory>

#include "arrays.hpp"
#include "docdepth/dynamics/key_frame.hpp"
#include "docdepth/dynamics/moving_cubes.hpp"
#include "docdepth/dynamics/objects.hpp"
#include "docdepth/dynamics/range_image.hpp"
#include "docdepth/dynamics/sighting.hpp"
#include "docdepth/dynamics/surface_image.hpp"
#include "docdepth/dynamics/tracks.hpp"

PYBIND11_MAKE_OPAQUE(docdepth::Sighting)

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

std::unique_ptr<SurfaceImage> make_surface_image(const Array<float>& points,
                                                 const Array<bool>& ground, const Surface& surface,
                                                 const SurfaceImageParameters& parameters) {
  const PointMap map = as_points(points);
  const bool* flags = as_column(ground, map.rows(), "ground");
  check_surface(surface, map.rows());
  py::gil_scoped_release release;
  return std::make_unique<SurfaceImage>(map, flags, surface, parameters);
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

py::array_t<std::uint32_t> objects_of(const Array<float>& points, const Array<bool>& ground,
                                      const Surface& surface, const ObjectParameters& parameters) {
  const PointMap map = as_points(points);
  check_surface(surface, map.rows());
  const bool* flags = as_column(ground, map.rows(), "ground");
  std::vector<std::uint32_t> first;
  {
    py::gil_scoped_release release;
    first = connect_objects(map, flags, surface, parameters);
  }
  return to_numpy(std::move(first), {static_cast<py::ssize_t>(map.rows())});
}

/// The first points of objects, each before or at the points it stands for.
const std::uint32_t* as_first(const Array<std::uint32_t>& array, py::ssize_t size) {
  const std::uint32_t* first = as_column(array, size, "first");
  for (py::ssize_t i = 0; i < size; ++i)
    if (first[i] > i || first[first[i]] != first[i])
      throw std::invalid_argument("first must be what connect_objects made of these points");
  return first;
}

py::array_t<std::uint8_t> moving(const Array<float>& points, const Array<bool>& ground,
                                 const Array<std::uint32_t>& first,
                                 const Array<std::uint16_t>& statics,
                                 const Array<std::uint16_t>& dynamics, const Surface& surface,
                                 const ObjectParameters& parameters) {
  const PointMap map = as_points(points);
  check_surface(surface, map.rows());
  const bool* flags = as_column(ground, map.rows(), "ground");
  const std::uint32_t* f = as_first(first, map.rows());
  const std::uint16_t* s = as_column(statics, map.rows(), "statics");
  const std::uint16_t* d = as_column(dynamics, map.rows(), "dynamics");
  std::vector<std::uint8_t> result;
  {
    py::gil_scoped_release release;
    result = moving_points(map, flags, f, s, d, surface, parameters);
  }
  return to_numpy(std::move(result), {static_cast<py::ssize_t>(map.rows())});
}

py::array_t<std::uint8_t> with_loose(const Array<float>& points, const Array<bool>& ground,
                                     const Array<std::uint32_t>& first,
                                     const Array<std::uint16_t>& statics,
                                     const Array<std::uint16_t>& dynamics,
                                     const Array<bool>& moving,
                                     const ObjectParameters& parameters) {
  const PointMap map = as_points(points);
  const bool* flags = as_column(ground, map.rows(), "ground");
  const std::uint32_t* f = as_first(first, map.rows());
  const std::uint16_t* s = as_column(statics, map.rows(), "statics");
  const std::uint16_t* d = as_column(dynamics, map.rows(), "dynamics");
  const bool* m = as_column(moving, map.rows(), "moving");
  std::vector<std::uint8_t> result(m, m + map.rows());
  {
    py::gil_scoped_release release;
    add_loose_points(map, flags, f, s, d, parameters, result);
  }
  return to_numpy(std::move(result), {static_cast<py::ssize_t>(map.rows())});
}

py::array_t<std::uint8_t> with_inside(const Array<float>& points, const Array<bool>& ground,
                                      const Array<std::uint16_t>& statics,
                                      const Array<std::uint16_t>& dynamics,
                                      const Array<double>& pose, const Array<float>& boxes,
                                      const Array<std::uint64_t>& cubes, const Array<bool>& moving,
                                      const ObjectParameters& parameters) {
  const PointMap map = as_points(points);
  const bool* flags = as_column(ground, map.rows(), "ground");
  const std::uint16_t* s = as_column(statics, map.rows(), "statics");
  const std::uint16_t* d = as_column(dynamics, map.rows(), "dynamics");
  const bool* m = as_column(moving, map.rows(), "moving");
  const Pose T_world_lidar = as_pose(pose);
  if (boxes.ndim() != 2 || boxes.shape(1) != 6)
    throw std::invalid_argument("boxes are low and high corners, (K, 6)");
  const std::vector<std::uint64_t> sorted(cubes.data(), cubes.data() + cubes.size());
  std::vector<Extent> extents(boxes.shape(0));
  for (std::size_t k = 0; k < extents.size(); ++k) {
    extents[k].low = Eigen::Map<const Eigen::Vector3f>(boxes.data() + 6 * k);
    extents[k].high = Eigen::Map<const Eigen::Vector3f>(boxes.data() + 6 * k + 3);
  }
  std::vector<std::uint8_t> result(m, m + map.rows());
  {
    py::gil_scoped_release release;
    add_points_inside(map, flags, s, d, T_world_lidar, extents, sorted, parameters, result);
  }
  return to_numpy(std::move(result), {static_cast<py::ssize_t>(map.rows())});
}

std::unique_ptr<Sighting> make_sighting(const Array<float>& points, const Array<bool>& ground,
                                        const Array<std::uint32_t>& first,
                                        const Array<bool>& moving, const Array<double>& pose) {
  const PointMap map = as_points(points);
  const bool* flags = as_column(ground, map.rows(), "ground");
  const std::uint32_t* f = as_first(first, map.rows());
  const bool* m = as_column(moving, map.rows(), "moving");
  const Pose T_world_lidar = as_pose(pose);
  py::gil_scoped_release release;
  return std::make_unique<Sighting>(sight(map, flags, f, m, T_world_lidar));
}

/// A sighting as arrays: first, points, dynamic and the number of places of each object; its box;
/// all places.
py::tuple arrays_of(const Sighting& seen) {
  const auto count = static_cast<py::ssize_t>(seen.size());
  std::vector<std::uint32_t> numbers;
  std::vector<float> boxes, places;
  for (const SeenObject& object : seen) {
    numbers.insert(numbers.end(), {object.first, object.points, object.dynamic,
                                   static_cast<std::uint32_t>(object.places.size())});
    for (const auto* corner : {&object.box.low, &object.box.high})
      boxes.insert(boxes.end(), corner->data(), corner->data() + 3);
    for (const auto& place : object.places)
      places.insert(places.end(), place.data(), place.data() + 3);
  }
  const auto all = static_cast<py::ssize_t>(places.size() / 3);
  return py::make_tuple(to_numpy(std::move(numbers), {count, 4}),
                        to_numpy(std::move(boxes), {count, 6}),
                        to_numpy(std::move(places), {all, 3}));
}

std::unique_ptr<Sighting> sighting_of(const Array<std::uint32_t>& numbers,
                                      const Array<float>& boxes, const Array<float>& places) {
  const PointMap all = as_points(places);
  if (numbers.ndim() != 2 || numbers.shape(1) != 4 || boxes.ndim() != 2 || boxes.shape(1) != 6 ||
      boxes.shape(0) != numbers.shape(0))
    throw std::invalid_argument("a sighting is numbers (K, 4), boxes (K, 6) and places (M, 3)");
  auto seen = std::make_unique<Sighting>(numbers.shape(0));
  Eigen::Index row = 0;
  for (std::size_t k = 0; k < seen->size(); ++k) {
    SeenObject& object = (*seen)[k];
    const std::uint32_t* n = numbers.data() + 4 * k;
    object.first = n[0], object.points = n[1], object.dynamic = n[2];
    object.box.low = Eigen::Map<const Eigen::Vector3f>(boxes.data() + 6 * k);
    object.box.high = Eigen::Map<const Eigen::Vector3f>(boxes.data() + 6 * k + 3);
    if (n[3] == 0 || row + n[3] > all.rows())
      throw std::invalid_argument("a sighting's places are fewer than its objects say");
    for (const Eigen::Index end = row + n[3]; row < end; ++row)
      object.places.push_back(all.row(row).transpose());
  }
  return seen;
}

py::list follow_all(const std::vector<const Sighting*>& sightings, const Array<double>& times,
                    const TrackParameters& parameters, int threads) {
  const auto count = static_cast<py::ssize_t>(sightings.size());
  const double* t = as_column(times, count, "times");
  for (const Sighting* seen : sightings)
    if (!seen) throw std::invalid_argument("follow needs a sighting of each sweep");
  std::vector<Followed> found;
  std::vector<std::vector<std::uint64_t>> seen_moving(sightings.size());
  {
    py::gil_scoped_release release;
    found = follow(sightings, {t, t + count}, parameters, threads);
    if (parameters.window > 0)
      seen_moving = moving_cubes(sightings, {t, t + count}, found, threads);
  }
  py::list result;
  for (std::size_t i = 0; i < found.size(); ++i) {
    auto& [rows, boxes] = found[i];
    const auto objects = static_cast<py::ssize_t>(rows.size());
    std::vector<float> corners;
    for (const Extent& box : boxes)
      for (const auto* corner : {&box.low, &box.high})
        corners.insert(corners.end(), corner->data(), corner->data() + 3);
    const auto ways = static_cast<py::ssize_t>(boxes.size()),
               cubes = static_cast<py::ssize_t>(seen_moving[i].size());
    result.append(py::make_tuple(to_numpy(std::move(rows), {objects}),
                                 to_numpy(std::move(corners), {ways, 6}),
                                 to_numpy(std::move(seen_moving[i]), {cubes})));
  }
  return result;
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
      .def_readwrite("ground_across", &SurfaceImageParameters::ground_across)
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
      .def_readwrite("least", &ObjectParameters::least)
      .def_readwrite("width", &ObjectParameters::width)
      .def_readwrite("height", &ObjectParameters::height)
      .def_readwrite("freed_share", &ObjectParameters::freed_share)
      .def_readwrite("freed_votes", &ObjectParameters::freed_votes)
      .def_readwrite("freed_ratio", &ObjectParameters::freed_ratio)
      .def_readwrite("loose_votes", &ObjectParameters::loose_votes);
  m.def("connect_objects", &objects_of, py::arg("points"), py::arg("ground"), py::arg("surface"),
        py::arg("parameters"));
  m.def("moving_points", &moving, py::arg("points"), py::arg("ground"), py::arg("first"),
        py::arg("statics"), py::arg("dynamics"), py::arg("surface"), py::arg("parameters"));
  m.def("add_loose_points", &with_loose, py::arg("points"), py::arg("ground"), py::arg("first"),
        py::arg("statics"), py::arg("dynamics"), py::arg("moving"), py::arg("parameters"));
  m.def("add_points_inside", &with_inside, py::arg("points"), py::arg("ground"), py::arg("statics"),
        py::arg("dynamics"), py::arg("T_world_lidar"), py::arg("boxes"), py::arg("cubes"),
        py::arg("moving"), py::arg("parameters"));
  py::class_<Sighting>(m, "Sighting")
      .def(py::init(&make_sighting), py::arg("points"), py::arg("ground"), py::arg("first"),
           py::arg("moving"), py::arg("T_world_lidar"))
      .def_static("of", &sighting_of, py::arg("numbers"), py::arg("boxes"), py::arg("places"))
      .def_property_readonly("arrays", &arrays_of);
  py::class_<TrackParameters>(m, "TrackParameters")
      .def(py::init<>())
      .def_readwrite("sightings", &TrackParameters::sightings)
      .def_readwrite("distance", &TrackParameters::distance)
      .def_readwrite("max_speed", &TrackParameters::max_speed)
      .def_readwrite("gap", &TrackParameters::gap)
      .def_readwrite("hold", &TrackParameters::hold)
      .def_readwrite("window", &TrackParameters::window);
  m.def("follow", &follow_all, py::arg("sightings"), py::arg("times"), py::arg("parameters"),
        py::arg("threads") = 0);
  py::class_<SurfaceImage, KeyFrame>(m, "SurfaceImage")
      .def(py::init(&make_surface_image), py::arg("points"), py::arg("ground"), py::arg("surface"),
           py::arg("parameters"));
  m.def("vote", &vote_on, py::arg("points"), py::arg("ground"), py::arg("T_world_lidar"),
        py::arg("key_frames"), py::arg("poses"), py::arg("threads") = 0);
}

}  // namespace docdepth::bindings
