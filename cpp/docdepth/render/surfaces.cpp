#include "docdepth/render/surfaces.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/render/edges.hpp"
#include "docdepth/render/speeds.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// Where a ray passed an object that moved on until the image is not known better than this [m].
constexpr float kCarried = 0.05f;

/// Objects are matched with those of as many sweeps, less one.
constexpr std::size_t kMatched = 3;

/// An object may reach this far beyond its returns [m].
constexpr float kAside = 2.0f;

/// A diamond around a return, across the line of sight.
void add_diamond(const Vector& p, float angle, std::vector<Vector>& vertices,
                 Triangles& triangles) {
  const float across = std::hypot(p.x(), p.y());
  const Vector left = across > 0 ? Vector(-p.y() / across, p.x() / across, 0) : Vector(0, 1, 0);
  const Vector side = left * (angle * p.norm()), up = p.cross(left) * angle;
  const auto first = static_cast<std::uint32_t>(vertices.size());
  for (const Vector& corner : {side, up, Vector(-side), Vector(-up)})
    vertices.push_back(p + corner);
  triangles.push_back({first, first + 1, first + 2});
  triangles.push_back({first, first + 2, first + 3});
}

/// Which objects the camera may see, wherever they went in the meantime.
std::vector<std::uint8_t> in_view(const Camera& camera, const Pose& T_camera_objects,
                                  const Objects& objects, float reach) {
  const Frustum frustum(camera, T_camera_objects);
  std::vector<std::uint8_t> seen;
  for (Box box : objects.boxes()) {
    box.extent.array() += reach;
    seen.push_back(frustum.touches(box));
  }
  return seen;
}

/// The objects of the nearest sweep where they were when the image was taken, and what the others
/// saw of those whose motion is known.
///
/// @param number of the nearest sweep; the others have the next
/// @param asks rays bear out how fast the objects are
std::vector<PlacedMover> carried(const Camera& camera, const Motion& motion, int number, bool asks,
                                 int threads) {
  std::vector<PlacedMover> placed;
  if (motion.sweeps.empty()) return placed;
  const auto& [nearest, since] = motion.sweeps[0];
  const Objects& objects = nearest.frame->objects;
  const auto passage_to = [&](const Motion::Sweep& sweep) {
    return Passage{nearest.T_camera_frame.inverse() * sweep.surface.T_camera_frame,
                   since - sweep.since, motion.max_speed};
  };
  std::vector<Witness> witnesses;
  for (std::size_t s = 1; asks && s < motion.sweeps.size(); ++s)
    witnesses.push_back({&motion.sweeps[s].surface.frame->rays, passage_to(motion.sweeps[s])});
  const float reach = kAside + motion.max_speed * std::fabs(since);
  const auto wanted = in_view(camera, nearest.T_camera_frame, objects, reach);
  Speeds speeds(objects, witnesses, wanted, threads);
  for (std::size_t s = 1; s < std::min(motion.sweeps.size(), kMatched); ++s)
    speeds.offer(velocities(objects, motion.sweeps[s].surface.frame->objects,
                            passage_to(motion.sweeps[s]), threads, speeds.doubted()));
  speeds.offer_around();
  const std::vector<Vector>& velocity = speeds.velocities();
  for (std::size_t k = 0; k < velocity.size(); ++k) {
    Pose T = nearest.T_camera_frame;
    T.translate((velocity[k] * (since - objects.late[k])).cast<double>());
    const auto& parts = nearest.frame->movers[k];
    placed.push_back({{{&parts.whole, T, number}, {&parts.inner, T, number, true}},
                      {{&parts.outer, T, number, true}},
                      {}});
    if (!velocity[k].isZero(0)) placed[k].rays.push_back({&nearest.frame->rays, T, kCarried});
  }
  std::vector<std::vector<Again>> again(motion.sweeps.size());
  parallel_for(again.size() - 1, 1, threads, [&](std::size_t begin, std::size_t) {
    const auto& sweep = motion.sweeps[begin + 1];
    again[begin + 1] =
        find_again(objects, velocity, sweep.surface.frame->objects, passage_to(sweep));
  });
  for (std::size_t s = 1; s < motion.sweeps.size(); ++s) {
    const MeshFrame& frame = *motion.sweeps[s].surface.frame;
    for (std::size_t k = 0; k < velocity.size(); ++k) {
      if (velocity[k].isZero(0)) continue;
      Pose T = placed[k].trusted[0].T_camera_mesh;
      T.translate(-again[s][k].shift.cast<double>());
      T = T * passage_to(motion.sweeps[s]).T_from_to;
      for (const auto c : again[s][k].objects)
        placed[k].others.push_back({&frame.movers[c].whole, T, number + int(s)});
      placed[k].rays.push_back({&frame.rays, T, kCarried});
    }
  }
  return placed;
}

}  // namespace

MeshFrame::MeshFrame(const Points& points, const std::uint32_t (*triangles)[3],
                     const std::uint8_t* cut, std::size_t triangle_count,
                     const std::uint32_t* loose, std::size_t loose_count, float loose_angle,
                     const std::uint16_t* classid, const float* late, const Points* starts)
    : objects(find_objects(points, classid, late)) {
  auto [vertices, parts, normals] = part_surface(points, triangles, cut, triangle_count,
                                                 objects.owner, objects.places.size() + 1);
  rays = Rays(points, normals, starts);
  std::vector<std::uint8_t> classes(vertices.size(), kNoClass);  // of places between returns
  for (Eigen::Index i = 0; i < points.rows(); ++i) classes[i] = class_of(classid[i]);
  for (std::size_t i = 0; i < loose_count; ++i) {
    add_diamond(points.row(loose[i]), loose_angle, vertices, parts[objects.owner[loose[i]]].whole);
    classes.resize(vertices.size(), class_of(classid[loose[i]]));
  }
  MeshVertices all(vertices, classes);
  world = Mesh(all, parts[0].whole);
  for (std::size_t k = 1; k < parts.size(); ++k)
    movers.push_back(
        {Mesh(all, parts[k].whole), Mesh(all, parts[k].inner), Mesh(all, parts[k].outer)});
}

Drawing drawing_of(const Camera& camera, const std::vector<PlacedMeshFrame>& fixed,
                   const Motion& motion, int witnesses, int threads) {
  Drawing drawing;
  const auto count = static_cast<int>(fixed.size());
  for (int i = 0; i < count; ++i)
    (i == 0 ? drawing.trusted : drawing.others)
        .push_back({&fixed[i].frame->world, fixed[i].T_camera_frame, i});
  for (int i = 0; i < std::min(count, witnesses); ++i)
    drawing.rays.push_back({&fixed[i].frame->rays, fixed[i].T_camera_frame});
  drawing.movers = carried(camera, motion, count, witnesses > 0, threads);
  if (witnesses == 0)
    for (PlacedMover& mover : drawing.movers) mover.rays.clear();
  return drawing;
}

std::vector<float> render_meshes(const Camera& camera, const std::vector<PlacedMeshFrame>& fixed,
                                 const Motion& motion, int witnesses, int threads) {
  return render_triangles(camera, drawing_of(camera, fixed, motion, witnesses, threads), threads);
}

}  // namespace docdepth
