// What a track says about the detections of any sweep.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "docdepth/evidence/object_track.hpp"

namespace docdepth {

/// What an object that moves at some time says about detections, by its track and path.
class TrackEvidence {
 public:
  TrackEvidence(ObjectTrack object, std::uint32_t number, const std::vector<double>& times,
                const TrackingOptions& options);

  const ObjectTrack& object() const { return object_; }
  std::uint32_t number() const { return number_; }

  /// Whether it stands when it is first or last seen, so that it was or stays there.
  bool stands_before() const;
  bool stands_after() const;

  /// Whether it is known where the object is: it stays where it stands when it is last seen.
  bool covers(double time) const;

  /// Around all detections besides its members that the track can make dynamic in a sweep at a time
  /// [s], and a little more; nothing if there are none.
  std::optional<Extent> reach(double time) const;

  /// Whether the track makes a detection dynamic.
  /// @param time       of its sweep [s]
  /// @param is_member  whether the track was followed through the detection
  bool makes_dynamic(double time, const Detection& object, bool is_member);

  /// Whether a detection is none of the object of which another one shows most: less of its place
  /// was free before or after, and both together are wider than any vehicle. So a parked car beside
  /// one that arrives stays static, though both looked like one object far away.
  bool are_apart(double time, const Detection& object, const Detection& best) const;

 private:
  /// Where it is when its place is known for the first or last time.
  struct KnownPlace {
    double time = 0;  ///< [s]
    Extent extent{};  ///< around all that lies in its box, and a little more
  };
  /// What the votes tell of the object while it is at a place.
  struct Occupancy {
    Eigen::Vector3d place;
    bool from_begin, to_end;  ///< of the drive: there it is when it is first or last seen
    int transient_count = 0;  ///< observations that are mostly transient
    int free_count = 0;       ///< observations that show that the place was free before or after
    float free_share = 0;     ///< in the mean
  };

  KnownPlace place_of(std::size_t observation) const;
  bool is_seen_to_move() const;
  bool drives_over(const Detection& object, double time) const;
  bool goes_through(const Detection& object, double time) const;
  bool lies_there(const Detection& object, double time, float margin) const;
  bool was_free(const Detection& object, double time);
  const Occupancy& occupancy_at(const Eigen::Vector3d& place);
  int first_over(const Detection& object, const Occupancy& occupancy, double share) const;
  int last_over(const Detection& object, const Occupancy& occupancy, double share) const;
  bool lies_over(std::size_t observation, const Detection& object, double share) const;

  ObjectTrack object_;
  std::uint32_t number_;
  TrackingOptions options_;
  std::vector<double> stamps_;  ///< of the sweep of each observation [s]
  int sweeps_;                  ///< of the drive
  bool drives_far_;
  bool is_vehicle_;
  bool seen_to_move_;    ///< while the votes called it dynamic
  float supported_ = 0;  ///< area of static points that the track can make dynamic
  bool is_known_ = false;
  KnownPlace first_, last_;  ///< if its place is known at all
  std::deque<Occupancy> occupancies_;
};

}  // namespace docdepth
