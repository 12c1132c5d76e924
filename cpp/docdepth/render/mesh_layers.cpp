#include <algorithm>
#include <cmath>
#include <limits>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/render/layers.hpp"
#include "docdepth/render/raster.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

/// The measurements of a pixel by the meshes drawn so far.
struct Tally {
  float difference = std::numeric_limits<float>::infinity();  // to the best mesh, relative
  std::int32_t mesh = -1, triangle = 0;
  std::uint16_t support = 0, measures = 0;
  float sum = 0, squares = 0;  // of the relative differences of the support
};

std::vector<const PlacedMesh*> meshes_of(const MeshScene& scene) {
  std::vector<const PlacedMesh*> meshes;
  for (const auto* list : {&scene.nearest, &scene.others})
    for (const PlacedMesh& mesh : *list) meshes.push_back(&mesh);
  for (const DynamicObjectScene& object : scene.dynamic_objects)
    for (const auto* list : {&object.nearest, &object.others, &object.extrapolated})
      for (const PlacedMesh& mesh : *list) meshes.push_back(&mesh);
  return meshes;
}

/// The dynamic object of each mesh in the order of meshes_of(); -1 of static ones.
std::vector<std::int32_t> objects_of_meshes(const MeshScene& scene) {
  std::vector<std::int32_t> objects(scene.nearest.size() + scene.others.size(), -1);
  for (std::size_t k = 0; k < scene.dynamic_objects.size(); ++k) {
    const DynamicObjectScene& object = scene.dynamic_objects[k];
    const auto meshes = object.nearest.size() + object.others.size() + object.extrapolated.size();
    objects.insert(objects.end(), meshes, std::int32_t(k));
  }
  return objects;
}

/// Draws each mesh alone and compares it with the depth map.
struct CountMeasurements {
  DOCDEPTH_KERNEL static void run(const Camera& camera,
                                  const std::vector<const PlacedMesh*>& meshes,
                                  std::size_t dynamic_objects, const float* depth, Strip& strip,
                                  std::vector<Tally>& tallies) {
    // A pixel is compared with static meshes, or with objects if one of these is nearer to its
    // depth.
    std::vector<Tally> moving(tallies.size());
    for (std::size_t m = 0; m < meshes.size(); ++m) {
      std::fill(strip.inverse_depth.begin(), strip.inverse_depth.end(), 0.0f);
      if (!draw_mesh<true>(camera, *meshes[m], strip)) continue;
      auto& compared = m < dynamic_objects ? tallies : moving;
      for (int v = 0; v < strip.height; ++v)
        for (int u = strip.begin; u < strip.end; ++u) {
          const float z = depth[std::size_t(v) * camera.width + u];
          const std::size_t i = std::size_t(v) * Strip::kStride + (u - strip.begin);
          const float w = strip.inverse_depth[i];
          if (!(w > 0 && z > 0)) continue;
          Tally& tally = compared[i];
          const float off = (1.0f / w - z) / z;
          if (std::fabs(off) < tally.difference) {
            tally.difference = std::fabs(off);
            tally.mesh = static_cast<std::int32_t>(m);
            tally.triangle = strip.numbers[i];
          }
          if (meshes[m]->split) continue;
          ++tally.measures;
          if (std::fabs(off) > kAgree) continue;
          ++tally.support;
          tally.sum += off;
          tally.squares += off * off;
        }
    }
    for (std::size_t i = 0; i < tallies.size(); ++i)
      if (moving[i].difference < tallies[i].difference) tallies[i] = moving[i];
  }
};

/// An edge may be drawn a pixel farther out than any mesh reaches. Such a pixel takes the mesh of
/// the pixel in its tile with the most similar depth.
void assign_moved_edges(const Camera& camera, const float* depth, const Strip& strip,
                        std::vector<Tally>& tallies) {
  const std::vector<Tally> drawn = tallies;
  for (int v = 0; v < strip.height; ++v)
    for (int u = strip.begin; u < strip.end; ++u) {
      const float z = depth[std::size_t(v) * camera.width + u];
      Tally& tally = tallies[std::size_t(v) * Strip::kStride + (u - strip.begin)];
      if (!(z > 0) || tally.difference <= kAgree) continue;
      const bool none = tally.mesh < 0;
      int left = u - (u - strip.begin) % Strip::kTile, top = v - v % Strip::kTile;
      int right = std::min(left + Strip::kTile, strip.end);
      int bottom = std::min(top + Strip::kTile, strip.height);
      if (none) {  // an object may go on farther than a tile
        left = std::max(u - Strip::kTile, strip.begin);
        top = std::max(v - Strip::kTile, 0);
        right = std::min(u + Strip::kTile, strip.end);
        bottom = std::min(v + Strip::kTile, strip.height);
      }
      for (int row = top; row < bottom; ++row)
        for (int column = left; column < right; ++column) {
          const Tally& one = drawn[std::size_t(row) * Strip::kStride + (column - strip.begin)];
          const float off = std::fabs(depth[std::size_t(row) * camera.width + column] - z) / z;
          if (one.mesh < 0 || (one.difference > kAgree && !none)) continue;
          if (!(off < tally.difference)) continue;
          tally.difference = off;
          tally.mesh = one.mesh;
          tally.triangle = one.triangle;
        }
    }
}

float deviation_of(const Tally& tally, float depth) {
  if (tally.support < 2) return kNaN;
  const float mean = tally.sum / tally.support;
  const float variance = (tally.squares - tally.sum * mean) / float(tally.support - 1);
  return depth * std::sqrt(std::max(variance, 0.0f));
}

/// A triangle in the frame of its mesh.
struct Triangle {
  Vector corner[3];
  std::uint8_t classid[3];
};

Triangle triangle_of(const PatchMesh& mesh, std::uint32_t number) {
  const auto& patches = mesh.patches();
  const auto after = std::upper_bound(
      patches.begin(), patches.end(), number,
      [](std::uint32_t n, const PatchMesh::Patch& patch) { return n < patch.triangle; });
  const std::uint32_t first = (after - 1)->vertex;
  Triangle triangle;
  for (int k = 0; k < 3; ++k) {
    const std::uint32_t i = first + mesh.corners()[number][k];
    triangle.corner[k] = {mesh.x()[i], mesh.y()[i], mesh.z()[i]};
    triangle.classid[k] = mesh.classes()[i];
  }
  return triangle;
}

/// Class of the nearest corner that is a return.
std::uint8_t class_at(const Triangle& triangle, const Vector& place) {
  float nearest = std::numeric_limits<float>::infinity();
  std::uint8_t classid = kNoClass;
  for (int k = 0; k < 3; ++k) {
    const float distance = (triangle.corner[k] - place).squaredNorm();
    if (triangle.classid[k] == kNoClass || distance >= nearest) continue;
    nearest = distance;
    classid = triangle.classid[k];
  }
  return classid;
}

}  // namespace

Layers::Layers(const Camera& camera, bool with_normals) {
  const std::size_t pixels = std::size_t(camera.width) * camera.height;
  sweep.resize(pixels, -1);
  classid.resize(pixels, kNoClass);
  measured.resize(pixels, 0);
  instance.resize(pixels, 0);
  range.resize(pixels, kNaN);
  normal.resize(with_normals ? 3 * pixels : 0, kNaN);
  support.resize(pixels, 0);
  measures.resize(pixels, 0);
  deviation.resize(pixels, kNaN);
}

Layers layers_of_triangles(const Camera& camera, const MeshScene& scene, const float* depth,
                           bool with_seen, int threads) {
  const auto meshes = meshes_of(scene);
  const std::size_t dynamic_objects = scene.nearest.size() + scene.others.size();
  Layers layers(camera, true);
  const std::vector<std::int32_t> object_of_mesh = objects_of_meshes(scene);
  std::vector<std::int32_t> objects(with_seen ? layers.sweep.size() : 0, -1);
  parallel_for(camera.width, kStrip, threads, [&](std::size_t begin, std::size_t end) {
    Strip strip(static_cast<int>(begin), static_cast<int>(end), camera.height);
    strip.numbers.resize(strip.inverse_depth.size());
    std::vector<Tally> tallies(strip.inverse_depth.size());
    dispatch<CountMeasurements>(camera, meshes, dynamic_objects, depth, strip, tallies);
    assign_moved_edges(camera, depth, strip, tallies);
    for (int v = 0; v < camera.height; ++v)
      for (int u = strip.begin; u < strip.end; ++u) {
        const Tally& tally = tallies[std::size_t(v) * Strip::kStride + (u - strip.begin)];
        if (tally.mesh < 0) continue;
        const PlacedMesh& placed = *meshes[tally.mesh];
        const std::size_t i = std::size_t(v) * camera.width + u;
        const Vector ray(float((u - camera.cx) / camera.fx), float((v - camera.cy) / camera.fy), 1);
        const Vector place =
            (placed.T_camera_mesh.inverse() * (ray * depth[i]).cast<double>()).cast<float>();
        const auto triangle = triangle_of(*placed.mesh, std::uint32_t(tally.triangle));
        const Vector normal = (triangle.corner[1] - triangle.corner[0])
                                  .cross(triangle.corner[2] - triangle.corner[0]);
        const Vector turned =
            (placed.T_camera_mesh.linear() * normal.normalized().cast<double>()).cast<float>();
        Eigen::Map<Vector>(&layers.normal[3 * i]) = turned.dot(ray) > 0 ? Vector(-turned) : turned;
        if (with_seen) objects[i] = object_of_mesh[tally.mesh];
        layers.sweep[i] = placed.sweep;
        // Between its returns an object goes on as what it is.
        const bool of_object = std::size_t(tally.mesh) >= dynamic_objects;
        layers.classid[i] = of_object ? std::uint8_t(kDynamic) : class_at(triangle, place);
        layers.instance[i] = placed.instance;
        layers.measured[i] = !placed.split;
        layers.range[i] = place.norm();
        layers.support[i] = tally.support;
        layers.measures[i] = tally.measures;
        layers.deviation[i] = deviation_of(tally, depth[i]);
      }
  });
  if (with_seen) layers.seen = seen_pixels(camera, scene, depth, objects, threads);
  return layers;
}

}  // namespace docdepth
