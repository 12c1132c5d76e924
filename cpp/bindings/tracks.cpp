#include <cstdint>
#include <memory>

#include "docdepth/evidence/track_objects.hpp"
#include "objects.hpp"

namespace docdepth::bindings {
namespace {

struct MemberRow {
  std::uint32_t first, track, is_dynamic;
};

/// Members, boxes and voxels.
py::tuple sweep_of(const TrackedSweep& sweep) {
  std::vector<MemberRow> members;
  for (const Member& member : sweep.members)
    members.push_back({member.first, member.track, member.is_dynamic});
  std::vector<BoxRow> boxes;
  for (const TrackedBox& tracked : sweep.boxes) {
    BoxRow& row = boxes.emplace_back();
    row.track = tracked.track;
    row.is_moving = tracked.is_moving;
    Eigen::Map<Rows3x4>{row.T_box_world[0]} = tracked.box.T_box_world.affine();
    row.half_size = as_array(tracked.box.half);
  }
  return py::make_tuple(to_numpy(std::move(members)), to_numpy(std::move(boxes)),
                        to_numpy(std::vector<std::uint64_t>(sweep.voxels)));
}

py::tuple object_of(const TrackedObject& object) {
  const auto count = static_cast<py::ssize_t>(object.places.size());
  Array<std::int64_t> sweeps(count), points(count);
  Array<double> poses({count, py::ssize_t{4}, py::ssize_t{4}}), velocities({count, py::ssize_t{3}});
  Array<double> deviations(count), surface_deviations(count), size(3);
  for (py::ssize_t k = 0; k < count; ++k) {
    const TrackedObject::Place& place = object.places[std::size_t(k)];
    sweeps.mutable_at(k) = place.sweep;
    points.mutable_at(k) = place.points;
    Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(poses.mutable_data(k, 0, 0)) =
        place.T_world_object.matrix();
    Eigen::Map<Eigen::Vector3d>(velocities.mutable_data(k, 0)) = place.velocity;
    deviations.mutable_at(k) = place.deviation;
    surface_deviations.mutable_at(k) = place.surface_deviation;
  }
  Eigen::Map<Eigen::Vector3d>(size.mutable_data()) = object.size.cast<double>();
  return py::make_tuple(sweeps, points, poses, velocities, deviations, surface_deviations, size,
                        object.rigid);
}

/// Calls `take` with a tuple for each sweep in order: rows of members, rows of
/// boxes, dynamic voxels. Returns a tuple a track: sweeps, points, poses,
/// velocities, two deviations, size, whether it is rigid. `read` gives the
/// detections of a sweep, and is cached for each several times; `buffer_size`
/// sweeps are in memory at once. `progress` is called with the share that is
/// done.
py::list track(const py::function& read, const Array<double>& times, int threads,
               const py::function& take, py::ssize_t buffer_size, const py::function& progress) {
  const auto count = times.size();
  const double* t = as_column(times, count, "times");
  for (py::ssize_t i = 0; i < count; ++i) {
    in_range(t[i], -1e12, 1e12, "a time in seconds");
    if (i > 0 && !(t[i] > t[i - 1])) throw std::invalid_argument("times must increase");
  }
  if (buffer_size < 1) throw std::invalid_argument("buffer_size must be at least 1");
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
  const auto tell = [&](double share) {
    const py::gil_scoped_acquire acquire;
    progress(share);
  };
  std::vector<TrackedObject> tracked = without_gil([&] {
    return track_objects(detections, {t, t + count}, threads, give, std::size_t(buffer_size), {},
                         tell);
  });
  py::list objects;
  for (TrackedObject& object : tracked) {
    objects.append(object_of(object));
    object = {};
  }
  return objects;
}

}  // namespace

void bind_tracks(py::module_& m) {
  using namespace py::literals;
  PYBIND11_NUMPY_DTYPE(MemberRow, first, track, is_dynamic);
  m.def("track_objects", &track, "read"_a, "times"_a, "threads"_a, "take"_a, "buffer_size"_a,
        "progress"_a);
}

}  // namespace docdepth::bindings
