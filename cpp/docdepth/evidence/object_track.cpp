#include "docdepth/evidence/object_track.hpp"

#include <algorithm>

#include "docdepth/tracking/constants.hpp"

namespace docdepth {
namespace {

/// While an object moves, this share of its area was free before or after. A fence of which each
/// sweep hits other slats seems to go along with the LiDAR, too, but slats stand at its places
/// before and after: where it is seen all along, 0.07 of it are free at most, of people who walk in
/// single file 0.14 and more.
/// Of a vehicle that drives far, this share is transient: of a scaffold that seems to, 0.02 at
/// most.
constexpr float kMovingFreeShare = 0.12f;
/// Where this share is transient, the object moves in any case: of sparse ones it is not known
/// which places were free (kMaxIsolatedShare).
constexpr float kSurelyTransientShare = 0.99f;
/// A fence is flat: thinner than anybody [m], or than this share of its length. People in single
/// file are as porous as a fence, but their thickness is 0.24 of their length and more.
constexpr float kThinnestPerson = 0.12f;
constexpr float kFlatness = 0.2f;
/// What is flat is a fence if a larger share of it than this is porous, the thinner the less,
constexpr float kMaxPorousShare = 1 / 3.0f;
/// or if a smaller share is transient: of flat things that moved, 0.67 was at least.
constexpr float kFlatTransientShare = 0.6f;
/// But it is no fence if it goes so many times its length while this share is transient: 16 beams
/// show a strip of the side of a car.
constexpr float kNoFenceLengths = 30;
constexpr float kNoFenceShare = 0.9f;
/// What goes faster than somebody who runs [m/s] leaves its place at once, so that this share of
/// it is found free at some time: 0.43 at least, of pieces of fences and hedges 0.35 at most. Most
/// of it is transient, if it is as thin [m] as a piece of a fence of which sweeps hit other slats.
constexpr float kRunning = 4;
constexpr float kMinFoundFree = 0.4f;
constexpr float kMaxSlatWidth = 0.25f;
/// What is as thick and as high as somebody who walks [m], and goes where so large a share was
/// found free at some time, moves, too: in single file others are at his places before and after.
constexpr float kMinPersonWidth = 0.35f;
constexpr float kMinPersonHeight = 1;
constexpr float kFoundFreeInFile = 0.8f;
/// What is as long as a car [m], goes so many times its length, and once its length while
/// transient, is no fence, even where other vehicles hide that its place was free: lorries that
/// follow each other do. A shorter piece of a hedge may seem to move along with the LiDAR.
constexpr float kMinCarLength = 2.5f;
constexpr float kFarLengths = 3;
/// An object that is never seen to move stands where for so long [s] this share of it was free, in
/// the mean.
constexpr double kFreeWindow = 2;
constexpr float kMeanFreeShare = 0.4f;
/// A vehicle is at least this wide from any side, and this high [m].
constexpr float kMinVehicleWidth = 0.5f;
constexpr float kMinVehicleHeight = 0.6f;

/// Whether for a while much of it was found where nothing was before or after.
bool appears(const std::vector<TrackObservation>& seen, const std::vector<double>& times,
             int min_detections) {
  float share = 0;
  std::size_t first = 0;
  for (std::size_t k = 0; k < seen.size(); ++k) {
    share += seen[k].free_area / seen[k].area;
    while (times[seen[k].sweep] - times[seen[first].sweep] > kFreeWindow + kTimeTolerance) {
      share -= seen[first].free_area / seen[first].area;
      ++first;
    }
    const auto count = float(k + 1 - first);
    if (times[seen[k].sweep] - times[seen[first].sweep] >= kFreeWindow / 2 &&
        share >= kMeanFreeShare * count && int(count) >= min_detections)
      return true;
  }
  return false;
}

/// What of an object is here for a while only, while its path moves: shares of its area.
struct MovingShares {
  float transient = 0, free = 0;
  float found_free = 0;  ///< at some time, though perhaps occupied again
};

MovingShares shares_while_moving(const ObjectTrack& object, const std::vector<double>& times) {
  float area = 0;
  MovingShares shares;
  for (const TrackObservation& seen : object.track.observations) {
    if (object.path.speed(times[seen.sweep]) < kStanding) continue;
    area += seen.area;
    shares.transient += seen.transient_area;
    shares.free += seen.free_area;
    shares.found_free += std::max(seen.transient_area, seen.free_area + seen.porous_area);
  }
  if (area > 0) shares = {shares.transient / area, shares.free / area, shares.found_free / area};
  return shares;
}

float width_of(const TrackPath& path) {
  return path.extent().size().head<2>().minCoeff();
}

/// Whether it is flat, and rays hit and passed much of it in turn, or little is transient.
bool is_fence(const ObjectTrack& object, const MovingShares& shares) {
  float area = 0, porous_area = 0;
  for (const TrackObservation& seen : object.track.observations) {
    area += seen.area;
    porous_area += seen.porous_area;
  }
  const float width = width_of(object.path),
              length = object.path.extent().size().head<2>().maxCoeff();
  if (width >= std::max(kThinnestPerson, kFlatness * length)) return false;
  if (object.path.distance() >= kNoFenceLengths * length && shares.transient >= kNoFenceShare)
    return false;
  const float thinness = std::min(1.0f, 2 * width / kThinnestPerson);
  return porous_area > kMaxPorousShare * thinness * area || shares.transient < kFlatTransientShare;
}

/// Whether something so fast would have left its place, but was found there.
bool stays(const ObjectTrack& object, const MovingShares& shares, double seconds) {
  if (object.path.distance() < kRunning * float(seconds)) return false;
  return shares.found_free < kMinFoundFree ||
         (width_of(object.path) < kMaxSlatWidth && shares.transient < kMinFreeShare);
}

bool may_be_person(const TrackPath& path) {
  const Eigen::Vector3f size = path.extent().size();
  return !path.is_rigid() && width_of(path) >= kMinPersonWidth && size.z() >= kMinPersonHeight;
}

}  // namespace

bool is_rear_of_vehicle(const TrackPath& path) {
  const Eigen::Vector3f size = path.extent().size();
  return path.is_rigid() && size.x() < kMinVehicleWidth && size.y() >= kMinRigidWidth &&
         size.z() >= kMinVehicleHeight;
}

bool is_rail(const TrackPath& path) {
  const Eigen::Vector3f size = path.extent().size();
  return path.is_rigid() && size.x() >= kMinCarLength && size.y() < kMinVehicleWidth &&
         size.z() < kMinVehicleHeight;
}

bool is_vehicle(const TrackPath& path) {
  const Eigen::Vector3f size = path.extent().size();
  return path.is_rigid() && width_of(path) >= kMinVehicleWidth && size.z() >= kMinVehicleHeight;
}

bool drives_far(const TrackPath& path) {
  const float length = path.extent().size().x();
  return is_vehicle(path) && length >= kMinCarLength && path.distance() >= kFarLengths * length &&
         path.transient_distance() >= length;
}

bool moves(const ObjectTrack& object, const std::vector<double>& times,
           const TrackingOptions& options) {
  const auto& [track, path] = object;
  if (track.transient_count < options.min_detections) return false;
  const MovingShares shares = shares_while_moving(object, times);
  if (drives_far(path) && shares.transient >= kMovingFreeShare) return true;
  if (is_fence(object, shares)) return false;
  const double seconds =
      times[track.observations.back().sweep] - times[track.observations.front().sweep];
  const float distance = path.distance();
  if (distance >= options.min_distance && !stays(object, shares, seconds) &&
      (shares.free >= kMovingFreeShare || shares.transient >= kSurelyTransientShare ||
       (may_be_person(path) && shares.found_free >= kFoundFreeInFile)))
    return true;
  // In less than a second, somebody may walk and not leave his place.
  if (distance >= kSamePlace * std::clamp(seconds, 0.5, 1.0) && shares.free >= kMinFreeShare)
    return true;
  return is_vehicle(path) && appears(track.observations, times, options.min_detections);
}

}  // namespace docdepth
