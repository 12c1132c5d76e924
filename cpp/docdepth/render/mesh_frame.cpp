#include "docdepth/render/mesh_frame.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/render/partitioned_mesh.hpp"
#include "docdepth/render/velocity_estimator.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

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

/// Which objects the camera may see, wherever they went since their sweep.
std::vector<std::uint8_t> in_view(const Camera& camera, const Pose& T_camera_objects,
                                  const DynamicObjects& objects, float reach) {
  const Frustum frustum(camera, T_camera_objects);
  std::vector<std::uint8_t> seen;
  for (Box box : objects.boxes()) {
    box.extent.array() += reach;
    seen.push_back(frustum.touches(box));
  }
  return seen;
}

/// The sweeps from which dynamic objects are drawn, as seen from the nearest one.
class ObjectPlacer {
 public:
  /// @param number  of the nearest sweep; the others have the next
  ObjectPlacer(const Camera& camera, const DynamicSweeps& dynamic, int number, int threads)
      : camera_(camera),
        dynamic_(dynamic),
        number_(number),
        threads_(threads),
        nearest_(dynamic.sweeps[0].mesh),
        age_(dynamic.sweeps[0].age),
        objects_(nearest_.frame->objects) {}

  /// The objects at the time of the image, as the nearest sweep and, where their velocity is known,
  /// the other sweeps saw them.
  /// @param verify  velocities by rays
  std::vector<PlacedDynamicObject> place(bool verify) const {
    const std::vector<Vector> velocity = velocities(verify);
    std::vector<PlacedDynamicObject> placed;
    for (std::size_t k = 0; k < velocity.size(); ++k) {
      Pose T = nearest_.T_camera_frame;
      T.translate((velocity[k] * (age_ - objects_.time_offset[k])).cast<double>());
      const auto& parts = nearest_.frame->dynamic_meshes[k];
      placed.push_back({{{&parts.whole, T, number_}, {&parts.inner, T, number_, true}},
                        {{&parts.outer, T, number_, true}},
                        {}});
      if (!velocity[k].isZero(0))
        placed[k].rays.push_back({&nearest_.frame->rays, T, kMovedRayBlur, age_});
      placed[k].velocity =
          (nearest_.T_camera_frame.linear() * velocity[k].cast<double>()).cast<float>();
    }
    add_other_sweeps(velocity, placed);
    return placed;
  }

 private:
  RelativeMotion motion_to(const DynamicSweeps::Sweep& sweep) const {
    return {nearest_.T_camera_frame.inverse() * sweep.mesh.T_camera_frame, age_ - sweep.age,
            dynamic_.max_speed};
  }

  std::vector<Vector> velocities(bool verify) const {
    const auto& sweeps = dynamic_.sweeps;
    std::vector<VisibilitySweep> verifying;
    for (std::size_t s = 1; verify && s < sweeps.size(); ++s)
      verifying.push_back({&sweeps[s].mesh.frame->rays, motion_to(sweeps[s])});
    const float reach = kObjectReach + dynamic_.max_speed * std::fabs(age_);
    const auto wanted = in_view(camera_, nearest_.T_camera_frame, objects_, reach);
    VelocityEstimator estimator(objects_, verifying, wanted, threads_);
    for (std::size_t s = 1; s < std::min(sweeps.size(), kMatchedSweeps + 1); ++s)
      estimator.propose(match_velocities(objects_, sweeps[s].mesh.frame->objects,
                                         motion_to(sweeps[s]), threads_, estimator.unverified()));
    estimator.propose_neighbors();
    return estimator.velocities();
  }

  /// Add what the other sweeps saw of the objects whose velocity is known, and their rays.
  void add_other_sweeps(const std::vector<Vector>& velocity,
                        std::vector<PlacedDynamicObject>& placed) const {
    const auto& sweeps = dynamic_.sweeps;
    std::vector<std::vector<Reassociation>> found(sweeps.size());
    parallel_for(found.size() - 1, 1, threads_, [&](std::size_t begin, std::size_t) {
      const auto& sweep = sweeps[begin + 1];
      found[begin + 1] =
          reassociate(objects_, velocity, sweep.mesh.frame->objects, motion_to(sweep));
    });
    for (std::size_t s = 1; s < sweeps.size(); ++s) {
      const MeshFrame& frame = *sweeps[s].mesh.frame;
      for (std::size_t k = 0; k < velocity.size(); ++k) {
        if (velocity[k].isZero(0)) continue;
        Pose T = placed[k].trusted[0].T_camera_mesh;
        T.translate(-found[s][k].shift.cast<double>());
        T = T * motion_to(sweeps[s]).T_from_to;
        for (const auto c : found[s][k].objects)
          placed[k].others.push_back({&frame.dynamic_meshes[c].whole, T, number_ + int(s)});
        placed[k].rays.push_back({&frame.rays, T, kMovedRayBlur, sweeps[s].age});
      }
    }
  }

  const Camera& camera_;
  const DynamicSweeps& dynamic_;
  int number_, threads_;
  const PlacedMeshFrame& nearest_;
  float age_;
  const DynamicObjects& objects_;
};

}  // namespace

MeshFrame::MeshFrame(const Points& points, const std::uint32_t (*triangles)[3],
                     const std::uint8_t* discontinuity, std::size_t triangle_count,
                     const std::uint32_t* isolated, std::size_t isolated_count,
                     float isolated_angle, const std::uint16_t* classid, const float* time_offset,
                     const Points* ray_origins)
    : objects(find_dynamic_objects(points, classid, time_offset)) {
  auto [vertices, parts, normals] = partition_mesh(points, triangles, discontinuity, triangle_count,
                                                   objects.owner, objects.samples.size() + 1);
  rays = Rays(points, normals, ray_origins, time_offset, objects.owner.data());
  std::vector<std::uint8_t> classes(vertices.size(), kNoClass);  // of vertices between returns
  for (Eigen::Index i = 0; i < points.rows(); ++i) classes[i] = class_of(classid[i]);
  for (std::size_t i = 0; i < isolated_count; ++i) {
    add_diamond(points.row(isolated[i]), isolated_angle, vertices,
                parts[objects.owner[isolated[i]]].whole);
    classes.resize(vertices.size(), class_of(classid[isolated[i]]));
  }
  MeshVertices all(vertices, classes);
  static_mesh = PatchMesh(all, parts[0].whole);
  for (std::size_t k = 1; k < parts.size(); ++k)
    dynamic_meshes.push_back({PatchMesh(all, parts[k].whole), PatchMesh(all, parts[k].inner),
                              PatchMesh(all, parts[k].outer)});
}

MeshScene compose_scene(const Camera& camera, const std::vector<PlacedMeshFrame>& static_frames,
                        const DynamicSweeps& dynamic, int visibility_sweeps, int threads) {
  MeshScene scene;
  const auto count = static_cast<int>(static_frames.size());
  for (int i = 0; i < count; ++i)
    (i == 0 ? scene.trusted : scene.others)
        .push_back({&static_frames[i].frame->static_mesh, static_frames[i].T_camera_frame, i});
  for (int i = 0; i < std::min(count, visibility_sweeps); ++i)
    scene.rays.push_back({&static_frames[i].frame->rays, static_frames[i].T_camera_frame});
  for (const auto& [mesh, age] : dynamic.sweeps)
    scene.shutter_rays.push_back({&mesh.frame->rays, mesh.T_camera_frame, kRayBlur, age});
  if (!dynamic.sweeps.empty())
    scene.dynamic_objects =
        ObjectPlacer(camera, dynamic, count, threads).place(visibility_sweeps > 0);
  if (visibility_sweeps == 0)
    for (PlacedDynamicObject& object : scene.dynamic_objects) object.rays.clear();
  return scene;
}

std::vector<float> render_meshes(const Camera& camera,
                                 const std::vector<PlacedMeshFrame>& static_frames,
                                 const DynamicSweeps& dynamic, int visibility_sweeps, int threads) {
  return render_triangles(
      camera, compose_scene(camera, static_frames, dynamic, visibility_sweeps, threads), threads);
}

}  // namespace docdepth
