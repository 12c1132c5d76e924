#include "docdepth/dynamics/sighting.hpp"

#include "docdepth/geometry/rigid.hpp"

namespace docdepth {
namespace {

constexpr std::uint32_t kFewestPoints = 5;
constexpr float kThin = 0.15f;        ///< edge of the cubes of which each gives one place
constexpr std::size_t kPlaces = 100;  ///< of larger objects the cubes are larger
constexpr float kWide = 25.0f;        ///< no vehicle; its places only tell what is taken
constexpr float kThinWide = 0.25f;

Places thinned_fast(const Places& points, const Extent& box) {
  if (box.width() > kWide) return thinned(points, kThinWide);
  float size = kThin;
  Places places = thinned(points, size);
  while (places.size() > kPlaces) places = thinned(places, size *= 1.3f);
  return places;
}

}  // namespace

Detections sight(const Points& points, const bool* ground, const std::uint32_t* first,
                 const bool* moving, const Pose& T_world_lidar) {
  const auto count = static_cast<std::uint32_t>(points.rows());
  std::vector<std::uint32_t> size(count, 0), place(count, 0);
  for (std::uint32_t i = 0; i < count; ++i)
    if (!ground[i]) ++size[first[i]];
  Detections seen;
  std::vector<Places> members;
  const RigidTransform T(T_world_lidar);
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::uint32_t f = first[i];
    if (ground[i] || size[f] < kFewestPoints) continue;
    const Eigen::Vector3f p = T * Eigen::Vector3f(points(i, 0), points(i, 1), points(i, 2));
    if (f == i) {
      place[f] = static_cast<std::uint32_t>(seen.size());
      seen.push_back({f, 0, 0, {p, p}, {}});
      members.emplace_back().reserve(size[f]);
    }
    Detection& object = seen[place[f]];
    ++object.points;
    object.dynamic += moving[i];
    object.box.add({p, p});
    members[place[f]].push_back(p);
  }
  for (std::size_t k = 0; k < seen.size(); ++k)
    seen[k].places = thinned_fast(members[k], seen[k].box);
  return seen;
}

}  // namespace docdepth
