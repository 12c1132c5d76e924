#include "docdepth/render/surfaces.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/render/edges.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

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

/// The same seen from the other sweep.
Motion reversed(const Motion& motion) {
  return {motion.other, motion.nearest, -motion.duration, motion.delay - motion.duration,
          motion.max_speed};
}

/// The objects of the nearest sweep where they were when the image was taken, and of those that the
/// other one found, too, what that measured.
///
/// @param sweep number of the nearest sweep; the other one has the next
std::vector<PlacedMover> carried(const Motion& motion, int sweep, int threads) {
  std::vector<PlacedMover> placed;
  for (const bool first : {true, false}) {
    const auto& [nearest, other, duration, delay, max_speed] = first ? motion : reversed(motion);
    const Passage passage{nearest.T_camera_frame.inverse() * other.T_camera_frame, duration,
                          max_speed};
    const Objects& objects = nearest.frame->objects;
    const auto velocity = velocities(objects, other.frame->objects, passage, threads);
    for (std::size_t k = 0; k < velocity.size(); ++k) {
      const bool found = !velocity[k].isZero(0);
      if (!first && !found) continue;
      // What stood in the frame of the nearest sweep some seconds after its stamp.
      const auto carry = [&, v = velocity[k], late = objects.late[k]](float after) {
        Pose T_camera_object = nearest.T_camera_frame;
        T_camera_object.translate((v * (delay - late - after)).cast<double>());
        return T_camera_object;
      };
      const auto& parts = nearest.frame->movers[k];
      PlacedMover mover{{{&parts.whole, carry(0), first ? sweep : sweep + 1}}, {}};
      if (first) mover.meshes.push_back({&parts.split, carry(0), sweep, true});
      if (found)
        mover.rays = {{&nearest.frame->rays, carry(0)},
                      {&other.frame->rays, carry(duration) * passage.T_from_to}};
      placed.push_back(std::move(mover));
    }
  }
  return placed;
}

}  // namespace

SurfaceFrame::SurfaceFrame(const Points& points, const std::uint32_t (*triangles)[3],
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
    movers.push_back({Mesh(all, parts[k].whole), Mesh(all, parts[k].split)});
}

Drawing drawing_of(const std::vector<PlacedSurface>& fixed, const Motion& motion, int witnesses,
                   int threads) {
  Drawing drawing;
  const auto count = static_cast<int>(fixed.size());
  for (int i = 0; i < count; ++i)
    (i == 0 ? drawing.trusted : drawing.others)
        .push_back({&fixed[i].frame->world, fixed[i].T_camera_frame, i});
  for (int i = 0; i < std::min(count, witnesses); ++i)
    drawing.rays.push_back({&fixed[i].frame->rays, fixed[i].T_camera_frame});
  drawing.movers = carried(motion, count, threads);
  if (witnesses == 0)
    for (PlacedMover& mover : drawing.movers) mover.rays.clear();
  return drawing;
}

std::vector<float> render_surfaces(const Camera& camera, const std::vector<PlacedSurface>& fixed,
                                   const Motion& motion, int witnesses, int threads) {
  return render_triangles(camera, drawing_of(fixed, motion, witnesses, threads), threads);
}

}  // namespace docdepth
