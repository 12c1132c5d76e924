// Rays that were measured around the shutter, and what those nearest to a place say of it.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <vector>

#include "docdepth/render/rays.hpp"

namespace docdepth {

/// What a ray ended on. What stands still tells nothing of what moves past it.
enum class Kind : std::uint8_t { kStatic = 0, kMoving = 1, kAny = 2 };

/// What a ray says of a place: it ended there, passed on, or ended before.
enum class Verdict : std::uint8_t { kNone, kEnded, kPassed, kBefore };

/// A place in the frame of the camera at the time of the image.
struct Place {
  Eigen::Vector3f point;
  Kind kind;  ///< rays that ended on others tell only of the space that they passed
  Eigen::Vector3f velocity = Eigen::Vector3f::Zero();  ///< rays saw it where it was then [m/s]
  float within = kShutter;  ///< rays count that were measured so long before or after the image [s]
};

/// What the nearest ray of a quadrant says of a place.
struct QuadrantRay {
  float squared = std::numeric_limits<float>::infinity();  ///< angle [units]
  float range = 0;                                         ///< of its end over that of the place
  Verdict verdict = Verdict::kNone;
  Eigen::Vector3f plane{0, 0, 0};  ///< where it ended, in the frame of the sweep
  std::size_t sweep = 0;
};
using QuadrantRays = std::array<QuadrantRay, 4>;

/// How many of the nearest rays say one of these.
int count(const QuadrantRays& corners, std::initializer_list<Verdict> verdicts);

/// The rays of the sweeps around the image.
class ShutterRays {
 public:
  explicit ShutterRays(const std::vector<SweepRays>& rays);
  ShutterRays(ShutterRays&&) noexcept;
  ~ShutterRays();

  /// The nearest ray in each quadrant of direction around a place, of those within kNearRays.
  QuadrantRays around(const Place& place) const;

  /// Whether a point in the frame of the camera lies on the plane where the ray ended.
  bool on_plane(const QuadrantRay& corner, const Eigen::Vector3f& point) const;

  /// How far apart the sensor sees two points of the frame of the camera, in mean distances between
  /// returns.
  float apart(const Eigen::Vector3f& a, const Eigen::Vector3f& b) const;

 private:
  class Sweep;
  struct FindRays;

  std::vector<Sweep> sweeps_;
};

}  // namespace docdepth
