// Votes of key frames on the points of a sweep (paper IV-C).
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Points of a sweep in the LiDAR frame of a key frame, one column per coordinate. Few enough for
/// their scratch memory to stay in the first level cache.
struct QueryPoints {
  static constexpr std::size_t kMax = 256;

  std::size_t size;  ///< at most kMax
  const float* x;
  const float* y;
  const float* z;
  const float* range;  ///< range_of(x, y, z), finite and positive [m]
  bool ground;         ///< whether they are labelled ground
};

/// A sweep made ready to vote on the points of other sweeps.
class KeyFrame {
 public:
  virtual ~KeyFrame() = default;

  /// Whether it votes on ground points.
  virtual bool votes_on_ground() const = 0;

  /// Find the pixel of each point and prefetch it: the images of all key frames fit into no cache.
  /// While the memory answers, other points are voted on.
  virtual void find(const QueryPoints& points, std::int32_t* pixels) const = 0;

  /// Add one vote on each point to static_votes or dynamic_votes, or none.
  /// @param pixels  from find()
  virtual void vote(const QueryPoints& points, const std::int32_t* pixels,
                    std::uint16_t* static_votes, std::uint16_t* dynamic_votes) const = 0;
};

/// How many key frames saw a surface at each point (statics) or through it (dynamics).
struct Votes {
  std::vector<std::uint16_t> statics, dynamics;
  /// 1 if the place was free, and was occupied in one stretch of time only, around the sweep. So it
  /// is where something arrives, leaves or passes. Twigs and fences are found free and occupied in
  /// turn.
  std::vector<std::uint8_t> occupied_once;
  /// 1 if the place was occupied, free, and occupied again within a second: rays hit and pass a
  /// thing in turn. Few road users follow each other so closely.
  std::vector<std::uint8_t> porous;
  /// The first and the last key frame that found the place occupied; kNever if none did.
  std::vector<std::uint16_t> first_occupied, last_occupied;
  static constexpr std::uint16_t kNever = 0xffff;
};

/// Let key frames vote on points. Points that are no returns (not finite or at the origin) get no
/// votes; ground points only from key frames that vote on ground.
/// @param ground       one flag per point
/// @param key_frames   in order of time
/// @param T_world_key  pose of each key frame
/// @param seconds      of each key frame after the sweep; infinite if that is not known
/// @param coarse_first  Where there are many key frames and returns, some vote on some points
///     first, and all of them only in directions where anything was found free: most of a sweep
///     never is. Elsewhere a point takes the votes on another one within a degree. Otherwise every
///     key frame votes on every point.
Votes vote(const Points& points, const bool* ground, const Pose& T_world_lidar,
           const std::vector<const KeyFrame*>& key_frames, const std::vector<Pose>& T_world_key,
           const std::vector<double>& seconds, int threads, bool coarse_first = false);

}  // namespace docdepth
