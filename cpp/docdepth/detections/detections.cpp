#include "docdepth/detections/detections.hpp"

#include <algorithm>
#include <cmath>

#include "docdepth/detections/quantile.hpp"
#include "docdepth/geometry/rigid.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// With a larger share of isolated returns nothing of an object counts as free: rays pass through
/// twigs and fences.
constexpr float kMaxIsolatedShare = 0.1f;
/// What is higher than a van, or higher than a car and longer than a van [m], has more samples than
/// kMaxSamples that are so far apart [m], up to 500: farther apart, those of a lorry miss those of
/// the next sweep by more than kMatchDistance where each sweep sees other parts of it. A row of
/// parked cars needs no more, and with them the car that arrives takes its neighbors along; a van
/// and the car beside it are 8 m long.
constexpr float kMaxCarHeight = 2.2f;
constexpr float kMaxVanHeight = 2.8f;
constexpr float kMaxVanLength = 10.0f;
constexpr float kMaxSampleSpacing = 0.33f;
/// Spacing of the samples of objects wider than kMaxObjectWidth [m].
constexpr float kWideSampleSpacing = 0.25f;
/// An object borders on what is this much nearer or farther [m].
constexpr float kMinBorderDepth = 0.5f;
/// The samples of its borders are so far apart [m], and at most so many are kept.
constexpr float kBorderSpacing = 0.1f;
constexpr std::size_t kMaxBorderSamples = 30;

/// Whether an object is as large as a lorry or a bus.
bool is_large(const Extent& box) {
  const Vector size = box.size();
  return size.z() > kMaxVanHeight ||
         (size.z() > kMaxCarHeight && size.head<2>().maxCoeff() > kMaxVanLength);
}

/// Samples of samples where each size would start from the points again: much faster, and as even.
TimedSurface sample(const TimedSurface& surface, const Extent& box) {
  if (box.width() > kMaxObjectWidth) return downsample(surface, kWideSampleSpacing);
  float size = kSampleSpacing;
  TimedSurface samples = downsample(surface, size);
  const float largest = largest_spacing(box);
  while (samples.points.size() > kMaxSamples && size < largest) {
    size = std::min(size * kSampleSpacingGrowth, largest);
    samples = downsample(samples, size);
  }
  return samples;
}

/// Normals at the points above the ground, of any length.
SampledPoints normals_of(const Points& points, const bool* ground, const ScanMesh& mesh) {
  SampledPoints normals(points.rows(), Vector::Zero());
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    const auto [i, j, k] = mesh.triangles[t];
    if (mesh.discontinuity[t] || (ground[i] && ground[j] && ground[k])) continue;
    const Vector p = points.row(i), q = points.row(j), r = points.row(k);
    const Vector normal = (q - p).cross(r - p);
    for (const auto corner : {i, j, k}) normals[corner] += normal;
  }
  return normals;
}

/// How each point borders on something else: bit 0 if farther, bit 1 if nearer.
std::vector<std::uint8_t> borders_of(const Points& points, const PointEvidence& evidence,
                                     const ScanMesh& mesh) {
  std::vector<std::uint8_t> borders(points.rows());
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (!mesh.discontinuity[t]) continue;
    const auto& corners = mesh.triangles[t];
    for (const auto i : corners)
      for (const auto j : corners) {
        if (evidence.ground[i] ||
            (!evidence.ground[j] && evidence.objects[i] == evidence.objects[j]))
          continue;
        const float farther = points.row(j).norm() - points.row(i).norm();
        if (std::fabs(farther) >= kMinBorderDepth) borders[i] |= farther > 0 ? 1 : 2;
      }
  }
  return borders;
}

/// When the places of an object were occupied, by the first and last sweeps of its points.
void find_occupancy(const std::vector<std::int32_t>& firsts, const std::vector<std::int32_t>& lasts,
                    Detection& object) {
  object.first_occupied = quantile(firsts, 0.5);
  object.last_occupied = quantile(lasts, 0.5);
  object.stands_since = quantile(firsts, kStandingShare);
  object.stands_until = quantile(lasts, 1 - kStandingShare);
}

/// How high the ground is under each object.
void find_ground(const Points& points, const bool* ground, const RigidTransform& T_world_lidar,
                 Detections& detections) {
  const GroundGrid heights(points, ground, T_world_lidar);
  for (Detection& object : detections)
    if (object.box.width() <= kMaxObjectWidth) object.ground = heights.under(object.box);
}

}  // namespace

float largest_spacing(const Extent& box) {
  return is_large(box) ? kMaxSampleSpacing : INFINITY;
}

Detections detect_objects(const Points& points, const PointEvidence& evidence, const ScanMesh& mesh,
                          const Pose& T_world_lidar) {
  const auto& [ground, objects, dynamic, occupied_once, porous, first_occupied, last_occupied,
               time_offset] = evidence;
  const auto count = static_cast<std::uint32_t>(points.rows());
  constexpr std::uint32_t kUnseen = 0xffffffff;
  std::vector<std::uint32_t> size(count, 0), number(count, kUnseen);
  for (std::uint32_t i = 0; i < count; ++i)
    if (!ground[i]) ++size[objects[i]];
  const SampledPoints normals = normals_of(points, ground, mesh);
  const std::vector<std::uint8_t> borders = borders_of(points, evidence, mesh);
  const Eigen::Matrix3f rotation = T_world_lidar.linear().cast<float>();
  Detections detections;
  std::vector<TimedSurface> members;
  std::vector<std::vector<std::int32_t>> firsts, lasts;
  std::vector<std::uint32_t> isolates;  // isolated returns of each object
  std::vector<std::uint8_t> isolated(count);
  for (const auto i : mesh.isolated) isolated[i] = 1;
  const RigidTransform T(T_world_lidar);
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::uint32_t first = objects[i];
    if (ground[i] || size[first] < kMinDetectionPoints) continue;
    const Vector here = points.row(i), p = T * here;
    if (number[first] == kUnseen) {
      number[first] = static_cast<std::uint32_t>(detections.size());
      detections.emplace_back();
      detections.back().first = first;
      detections.back().box = {p, p};
      members.emplace_back();
      isolates.push_back(0);
      firsts.emplace_back();
      lasts.emplace_back();
    }
    Detection& object = detections[number[first]];
    const float area = here.squaredNorm();
    ++object.points;
    object.area += area;
    object.middle += here;
    if (dynamic[i]) {
      ++object.dynamic_points;
      object.dynamic_area += area;
    }
    if (occupied_once[i]) object.free_area += area;
    if (porous[i]) object.porous_area += area;
    if (isolated[i]) ++isolates[number[first]];
    const float time = time_offset ? time_offset[i] : 0;
    object.time_offset += time;
    object.box.add({p, p});
    firsts[number[first]].push_back(first_occupied[i]);
    lasts[number[first]].push_back(last_occupied[i]);
    if (borders[i] == 1) object.edges.add(p, time);
    if (borders[i] & 2) object.hidden.add(p, time);
    members[number[first]].add(p, rotation * normals[i], time);
  }
  for (std::size_t k = 0; k < detections.size(); ++k) {
    detections[k].time_offset /= float(detections[k].points);
    detections[k].middle /= float(detections[k].points);
    if (float(isolates[k]) > kMaxIsolatedShare * float(detections[k].points))
      detections[k].free_area = 0;
    find_occupancy(firsts[k], lasts[k], detections[k]);
    for (TimedPoints* border : {&detections[k].edges, &detections[k].hidden})
      *border = downsample(*border, kBorderSpacing, kMaxBorderSamples);
    detections[k].surface = sample(members[k], detections[k].box);
    for (Vector& normal : detections[k].surface.normals)
      if (!normal.isZero(0)) normal.normalize();
  }
  find_ground(points, ground, T, detections);
  return detections;
}

}  // namespace docdepth
