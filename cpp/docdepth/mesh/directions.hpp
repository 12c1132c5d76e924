// The direction of a return as two integers: the same bits on every machine.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Larger ranges are no measurements [m]. Their squares fit a float.
constexpr float kMaxRange = 1e6f;

/// Sine of the smallest angle between a ray and a plane that is still believed: the road 80 m
/// ahead. A flatter plane joins the edge of an object to the background.
constexpr float kMinIncidenceSine = 0.02f;

/// Units to a turn: 0.0055 degrees or 1 cm at 100 m. Fine enough to tell neighbouring returns
/// apart, coarse enough for exact 64-bit geometry.
constexpr std::int32_t kTurn = 65536;
constexpr float kRadiansPerUnit = 6.283185307179586f / kTurn;

/// atan2 by a polynomial, error below 2e-6 rad; 0 for the origin. Plain operations in a fixed order
/// are vectorised and give the same bits everywhere, which no libm promises.
inline float atan2_fixed(float y, float x) {
  const float ax = std::fabs(x), ay = std::fabs(y);
  const float low = ax < ay ? ax : ay, high = ax < ay ? ay : ax;
  const float t = high > 0.0f ? low / high : 0.0f, s = t * t;
  // Abramowitz and Stegun 4.4.49, odd to the 17th power.
  float p = 0.0028662257f;
  p = p * s - 0.0161657367f;
  p = p * s + 0.0429096138f;
  p = p * s - 0.0752896400f;
  p = p * s + 0.1065626393f;
  p = p * s - 0.1420889944f;
  p = p * s + 0.1999355085f;
  p = p * s - 0.3333314528f;
  float angle = t + (p * s) * t;
  angle = ay > ax ? 1.57079632679f - angle : angle;
  angle = x < 0.0f ? 3.14159265359f - angle : angle;
  return y < 0.0f ? -angle : angle;
}

/// Azimuth and elevation in units; azimuth in [-kTurn/2, kTurn/2), elevation within a quarter turn.
struct Direction {
  std::int32_t azimuth, elevation;
};

inline Direction direction_of(float x, float y, float z) {
  const float across = std::sqrt(x * x + y * y);
  auto azimuth =
      static_cast<std::int32_t>(std::floor(atan2_fixed(y, x) * (1.0f / kRadiansPerUnit) + 0.5f));
  if (azimuth >= kTurn / 2) azimuth -= kTurn;
  const auto elevation = static_cast<std::int32_t>(
      std::floor(atan2_fixed(z, across) * (1.0f / kRadiansPerUnit) + 0.5f));
  return {azimuth, elevation};
}

/// Direction of every point; (0, 0) for points that are no returns: not finite, at the origin or
/// beyond kMaxRange.
std::vector<Direction> directions_of(const Points& points);

}  // namespace docdepth
