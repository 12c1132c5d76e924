#include "docdepth/evidence/followed.hpp"

#include <algorithm>

#include "docdepth/detections/constants.hpp"

namespace docdepth {
namespace {

/// Whether for a while much of it was found where nothing was before or after.
bool appears(const std::vector<TrackObservation>& seen, const std::vector<double>& times,
             const TrackParameters& p) {
  float share = 0;
  std::size_t first = 0;
  for (std::size_t k = 0; k < seen.size(); ++k) {
    share += seen[k].free_area / seen[k].area;
    while (times[seen[k].sweep] - times[seen[first].sweep] > kFreeWindow + kTimeTolerance)
      share -= seen[first].free_area / seen[first].area, ++first;
    const auto count = float(k + 1 - first);
    if (times[seen[k].sweep] - times[seen[first].sweep] >= kFreeWindow / 2 &&
        share >= kMeanFreeShare * count && int(count) >= p.min_detections)
      return true;
  }
  return false;
}

/// Whether it is higher than anything that drives, and does not go anywhere: a tree.
bool sways(const TrackPath& path) {
  const Eigen::Vector3f size = path.extent().size();
  return size.z() > kMaxVehicleHeight && path.distance(false) < size.head<2>().maxCoeff();
}

bool is_thin(const TrackPath& path) {
  const Eigen::Vector3f size = path.extent().size();
  return path.is_rigid() && size.x() >= kMinRailLength && size.y() < kMinVehicleWidth;
}

}  // namespace

bool is_side_of_vehicle(const TrackAndPath& followed) {
  const auto& [track, path] = followed;
  return is_thin(path) && path.extent().size().z() >= kMaxRailHeight &&
         2 * track.dynamic >= int(track.observations.size());
}

bool is_rear_of_vehicle(const TrackPath& path) {
  const Eigen::Vector3f size = path.extent().size();
  return path.is_rigid() && size.x() < kMinVehicleWidth && size.y() >= kMinRigidWidth &&
         size.z() >= kMinVehicleHeight;
}

bool is_rail(const TrackAndPath& followed) {
  return is_thin(followed.path) && !is_side_of_vehicle(followed);
}

bool is_vehicle(const TrackPath& path) {
  const Eigen::Vector3f size = path.extent().size();
  return path.is_rigid() && size.head<2>().minCoeff() >= kMinVehicleWidth &&
         size.z() >= kMinVehicleHeight;
}

bool moves(const TrackAndPath& followed, const std::vector<double>& times,
           const TrackParameters& p) {
  const auto& [track, path] = followed;
  if (track.dynamic < p.min_detections || sways(path)) return false;
  if (path.distance(false) >= p.min_distance &&
      path.distance(true) >= kMinVotedDistanceShare * p.min_distance)
    return true;
  return is_vehicle(path) && appears(track.observations, times, p);
}

}  // namespace docdepth
