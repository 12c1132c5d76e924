// Where something that was followed is at any time, and what it carries along.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/dynamics/tracks.hpp"

namespace docdepth {

constexpr float kStanding = 0.5f;  ///< slower things may be hidden for long [m/s]

/// What was seen of a track in a sweep.
struct Member {
  std::size_t sweep;
  std::vector<std::uint32_t> objects;  ///< of the sighting, by their number in it
  Extent box;
  std::size_t shown;  ///< points that move by the votes

  /// The middle of its box, from above.
  Eigen::Vector3f place() const {
    const Eigen::Vector3f middle = 0.5f * (box.low + box.high);
    return {middle.x(), middle.y(), 0};
  }
};

/// Whether what has this box may be the same thing as what was seen with another size.
bool could_be(const Extent& box, const Eigen::Vector3f& size);

/// Where a track is at any time, from its members in the order of time or against it.
class Way {
 public:
  /// @param times  of all sweeps, seconds; they and the parameters must outlive it
  Way(std::vector<Member> members, const std::vector<double>& times, const TrackParameters& p);

  /// Whether enough of it was seen to move for all that does not move now.
  bool carries(const Detection& now) const { return now.points - now.dynamic <= most_; }
  /// Whether it is known where it is: a little before and after its sightings, longer if it stands.
  bool reaches(double t) const;
  float speed(double t) const { return velocity(t).norm(); }
  /// The boxes of members that are near in time, or of the nearest one, moved along.
  Extent box(double t) const;
  /// Whether an object of a sweep is one of the members' own.
  bool has(std::size_t sweep, std::uint32_t object) const;
  /// Whether places were free when it was elsewhere, as the nearest such sweeps tell.
  bool were_free(const Places& places, std::size_t sweep,
                 const std::vector<const Detections*>& sightings) const;

 private:
  double time(std::size_t k) const { return times_[members_[k].sweep]; }
  Eigen::Vector3f velocity(double t) const;

  std::vector<Member> members_;
  std::vector<Extent> boxes_;  ///< where they are, as far as known
  std::size_t most_ = 0;       ///< points that it carries
  const std::vector<double>& times_;
  const TrackParameters& p_;
};

}  // namespace docdepth
