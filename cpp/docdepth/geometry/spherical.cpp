#include "docdepth/geometry/spherical.hpp"

#include "docdepth/geometry/simd.hpp"

namespace docdepth {
namespace {

constexpr float kPi = 3.14159265358979323846f;

// Single precision polynomials of the Cephes library (S. Moshier), exact to a few units in the last
// place.

/// asin(v), |v| <= 1.
DOCDEPTH_KERNEL float approximate_asin(float v) {
  const float a = std::fabs(v);
  const bool outer = a > 0.5f;
  const float t = outer ? 0.5f * (1.0f - a) : a * a;
  const float s = outer ? std::sqrt(t) : a;
  float p = 4.2163199048e-2f * t + 2.4181311049e-2f;
  p = p * t + 4.5470025998e-2f;
  p = p * t + 7.4953002686e-2f;
  p = p * t + 1.6666752422e-1f;
  p = p * t * s + s;
  return std::copysign(outer ? 0.5f * kPi - 2.0f * p : p, v);
}

/// |atan2(y, x)|, and 0 at the origin.
DOCDEPTH_KERNEL float approximate_atan2(float y, float x) {
  const float ax = std::fabs(x), ay = std::fabs(y);
  const float low = ax < ay ? ax : ay, high = ax < ay ? ay : ax;
  const bool outer = low > 0.41421356f * high;  // tan(pi / 8)
  const float t = (outer ? low - high : low) / (outer ? low + high : high + 1e-38f);
  const float s = t * t;
  float p = 8.05374449538e-2f * s - 1.38776856032e-1f;
  p = p * s + 1.99777106478e-1f;
  p = p * s - 3.33329491539e-1f;
  p = p * s * t + t;
  p = outer ? p + 0.25f * kPi : p;
  p = ay > ax ? 0.5f * kPi - p : p;
  return x < 0.0f ? kPi - p : p;
}

// Bound of the error of approximate angles [rad] while |z / rho| is below kSteep: half of it is the
// rounding of angles up to 2 pi, the rest comes from the polynomials and the quotients.
constexpr float kAngleError = 1.5e-6f;
constexpr float kSteep = 0.95f;
constexpr std::int32_t kUnsure = -1;

/// Pixels by approximate angles. Columns are kUnsure where the error bound reaches a border.
struct ApproximatePixels {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* x, const float* y, const float* z,
                                  const float* range, float pixels_per_radian, float margin,
                                  std::int32_t* __restrict rows, std::int32_t* __restrict columns) {
    for (std::size_t i = 0; i < count; ++i) {
      const float cosine = z[i] / range[i];
      const float azimuth = approximate_atan2(y[i], x[i]);
      const float row = (0.5f * kPi - approximate_asin(cosine)) * pixels_per_radian;
      const float column = (y[i] < 0.0f ? kPi + azimuth : kPi - azimuth) * pixels_per_radian;
      const auto whole_row = static_cast<std::int32_t>(row);
      const auto whole_column = static_cast<std::int32_t>(column);
      const float in_row = row - static_cast<float>(whole_row);
      const float in_column = column - static_cast<float>(whole_column);
      const bool sure = (in_row > margin) & (in_row < 1.0f - margin) & (in_column > margin) &
                        (in_column < 1.0f - margin) & (std::fabs(cosine) < kSteep);
      rows[i] = whole_row;
      columns[i] = sure ? whole_column : kUnsure;
    }
  }
};

}  // namespace

void SphericalGrid::pixels(std::size_t count, const float* x, const float* y, const float* z,
                           const float* range, std::int32_t* rows, std::int32_t* columns) const {
  const auto pixels_per_radian = static_cast<float>(1.0 / pixel_);
  // The products are rounded to a part of 2^24; they and the factor itself add two such errors.
  const float margin = kAngleError * pixels_per_radian + columns_ * 0x1p-23f;
  dispatch<ApproximatePixels>(count, x, y, z, range, pixels_per_radian, margin, rows, columns);
  for_each_flagged(count, columns, [&](std::size_t i) {
    rows[i] = row(z[i], range[i]);
    columns[i] = column(x[i], y[i]);
  });
}

}  // namespace docdepth
