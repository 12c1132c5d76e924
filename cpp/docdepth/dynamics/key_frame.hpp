// Votes of key frames on the points of a sweep (paper III-C2).
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Points of another sweep in the LiDAR frame of the key frame that is asked, a column each. Few
/// enough for their scratch to stay in the first level cache.
struct QueryPoints {
  static constexpr std::size_t kMax = 256;

  std::size_t size;  ///< at most kMax
  const float* x;
  const float* y;
  const float* z;
  const float* range;  ///< range_of(x, y, z); finite and above zero
  bool ground;         ///< whether they are called ground
};

/// A sweep made ready to be asked what it knows about the places of other points.
class KeyFrame {
 public:
  virtual ~KeyFrame() = default;

  /// Whether it is asked about points that are called ground, too.
  virtual bool asks_ground() const = 0;

  /// Find the pixel of each point, and have the memory fetch what it holds: the images of all key
  /// frames together fit into no cache, and while it comes others are voted on.
  virtual void find(const QueryPoints& points, std::int32_t* pixels) const = 0;

  /// Add this key frame's vote on each point: one to statics, one to dynamics, or none.
  /// @param pixels  from find()
  virtual void vote(const QueryPoints& points, const std::int32_t* pixels, std::uint16_t* statics,
                    std::uint16_t* dynamics) const = 0;
};

/// How many key frames saw a surface at the place of each point (statics), how many looked through
/// it (dynamics).
struct Votes {
  std::vector<std::uint16_t> statics, dynamics;
};

/// Ask every key frame about every point. Rows that are no returns (not finite, or at the origin)
/// get no votes, and ground points none of key frames that do not ask about them.
/// @param ground  one flag a point.
/// @param T_world_key  pose of each key frame.
Votes vote(const Points& points, const bool* ground, const Pose& T_world_lidar,
           const std::vector<const KeyFrame*>& key_frames, const std::vector<Pose>& T_world_key,
           int threads);

}  // namespace docdepth
