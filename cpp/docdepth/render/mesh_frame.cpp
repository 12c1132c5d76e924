#include "docdepth/render/mesh_frame.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <utility>

#include "docdepth/render/partitioned_mesh.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// The same for a dynamic object that was moved to the time of the image [m].
constexpr float kMovedRayBlur = 0.05f;

/// A diamond around a return, across its ray.
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

/// @param age  of the rays of a sweep [s], by its number
DynamicObjectScene place(const Camera& camera, const ObjectViews& object,
                         const std::function<float(int)>& age) {
  DynamicObjectScene placed;
  const auto add = [&](std::vector<PlacedMesh>& list, const PatchMesh& mesh, const ObjectView& from,
                       bool split) {
    const PixelBounds bounds = bounds_of(camera, from.placed.T_camera_frame, mesh.box());
    if (!mesh.size() || bounds.empty()) return;
    placed.bounds = placed.bounds.unite(bounds);
    list.push_back({&mesh, from.placed.T_camera_frame, from.sweep, split, object.instance});
  };
  const auto meshes = [](const ObjectView& from) -> const MeshFrame::DynamicMesh& {
    return from.placed.frame->dynamic_meshes[from.object_index - 1];
  };
  for (const ObjectView& from : object.around) {
    auto& surfaces = &from == object.around.data() ? placed.nearest : placed.others;
    add(surfaces, meshes(from).whole, from, false);
    add(surfaces, meshes(from).inner, from, true);
    add(placed.extrapolated, meshes(from).outer, from, true);
  }
  for (const ObjectView& from : object.others) add(placed.others, meshes(from).whole, from, false);
  for (const ObjectView& from : object.rays)
    placed.rays.push_back({&from.placed.frame->dynamic_meshes[from.object_index - 1].rays,
                           from.placed.T_camera_frame, kMovedRayBlur, age(from.sweep)});
  return placed;
}

}  // namespace

MeshFrame::MeshFrame(const MeshParts& parts) {
  const Points& points = parts.points;
  const std::size_t surfaces = parts.motions.size() + 1;
  auto mesh = partition_mesh(points, parts.triangles, parts.discontinuity, parts.triangle_count,
                             parts.object_index, surfaces, parts.drawn);
  std::vector<std::uint8_t> moving(points.rows());
  for (Eigen::Index i = 0; i < points.rows(); ++i) moving[i] = parts.object_index[i] != 0;
  rays = Rays(points, mesh.normals, parts.ray_origins, {}, parts.time_offset, moving.data());
  std::vector<Vector>& vertices = mesh.vertices;
  std::vector<std::uint8_t> classes(vertices.size(), kNoClass);  // of vertices between returns
  for (Eigen::Index i = 0; i < points.rows(); ++i) classes[i] = class_of(parts.classid[i]);
  for (std::size_t i = 0; i < parts.isolated_count; ++i) {
    const std::uint32_t alone = parts.isolated[i];
    add_diamond(points.row(alone), parts.isolated_angle, vertices,
                mesh.parts[parts.object_index[alone]].whole);
    classes.resize(vertices.size(), class_of(parts.classid[alone]));
    mesh.sources.resize(vertices.size(), alone);
  }
  if (parts.displacement)
    for (std::size_t i = 0; i < vertices.size(); ++i)
      vertices[i] += parts.displacement->row(mesh.sources[i]).transpose();
  MeshVertices all(vertices, classes);
  static_mesh = PatchMesh(all, mesh.parts[0].whole);
  static_outer = PatchMesh(all, mesh.parts[0].outer);
  std::vector<Rays> near = object_rays(parts, mesh.normals);
  dynamic_meshes.resize(surfaces - 1);
  for (std::size_t k = 1; k < surfaces; ++k)
    if (!parts.drawn || parts.drawn[k - 1])
      dynamic_meshes[k - 1] = {PatchMesh(all, mesh.parts[k].whole),
                               PatchMesh(all, mesh.parts[k].inner),
                               PatchMesh(all, mesh.parts[k].outer), std::move(near[k - 1])};
}

MeshScene compose_scene(const Camera& camera, const std::vector<PlacedMeshFrame>& static_frames,
                        const std::vector<ObjectViews>& objects, int visibility_sweeps,
                        const std::vector<ShutterSweep>& shutter_sweeps,
                        const std::vector<ObjectBox>& boxes, int nearest_frames) {
  MeshScene scene;
  const auto count = static_cast<int>(static_frames.size());
  for (int i = 0; i < count; ++i) {
    const auto& [frame, T_camera_frame] = static_frames[i];
    const PlacedMesh mesh{&frame->static_mesh, T_camera_frame, i};
    if (i < nearest_frames) {
      scene.nearest.push_back(mesh);
      scene.extrapolated.push_back({&frame->static_outer, T_camera_frame});
    }
    if (i > 0) scene.others.push_back(mesh);
  }
  for (int i = 0; i < std::min(count, visibility_sweeps); ++i)
    scene.rays.push_back({&static_frames[i].frame->rays, static_frames[i].T_camera_frame});
  for (const auto& [placed, age] : shutter_sweeps)
    scene.shutter_rays.push_back({&placed.frame->rays, placed.T_camera_frame, kRayBlur, age});
  scene.boxes = boxes;
  const auto age = [&](int sweep) {  // others were taken long before or after
    const bool around = sweep >= count && std::size_t(sweep - count) < shutter_sweeps.size();
    return around ? shutter_sweeps[sweep - count].age : std::numeric_limits<float>::infinity();
  };
  for (const ObjectViews& object : objects) {
    DynamicObjectScene placed = place(camera, object, age);
    if (!placed.bounds.empty()) scene.dynamic_objects.push_back(std::move(placed));
  }
  return scene;
}

}  // namespace docdepth
