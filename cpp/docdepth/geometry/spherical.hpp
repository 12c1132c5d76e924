// Pixels of a spherical image around a sensor (paper IV-C).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>

namespace docdepth {

/// Distance from the origin, in a fixed order of operations.
inline float range_of(float x, float y, float z) {
  return std::sqrt((x * x + y * y) + z * z);
}

/// Square pixels over all directions. Rows are phi = acos(z / rho), from straight up to straight
/// down. Columns are theta = -atan2(y, x), clockwise seen from above; column 0 begins straight
/// behind and columns wrap around.
class SphericalGrid {
 public:
  /// @param resolution  pixel size [rad]; rounded to the nearest value that divides the circle
  explicit SphericalGrid(double resolution) {
    if (!(resolution > 1e-4 && resolution < 1.0))
      throw std::invalid_argument("the resolution of a spherical image must be 1e-4 to 1 rad");
    columns_ = static_cast<int>(std::lround(2.0 * kPi / resolution));
    pixel_ = 2.0 * kPi / columns_;
  }

  int columns() const { return columns_; }
  int rows() const { return columns_ / 2 + 1; }
  double pixel() const { return pixel_; }

  /// Row of a point at height z and range rho > 0.
  int row(float z, float rho) const {
    const double cosine = static_cast<double>(z) / static_cast<double>(rho);
    return static_cast<int>(std::acos(std::clamp(cosine, -1.0, 1.0)) / pixel_);
  }

  /// Column of a point: (pi + theta) / pixel.
  int column(float x, float y) const {
    const double azimuth = std::atan2(static_cast<double>(y), static_cast<double>(x));
    const int column = static_cast<int>((kPi - azimuth) / pixel_);
    return column < columns_ ? column : 0;
  }

  /// row() and column() of many points with positive ranges: the same result, many times faster.
  void pixels(std::size_t count, const float* x, const float* y, const float* z, const float* range,
              std::int32_t* rows, std::int32_t* columns) const;

 private:
  static constexpr double kPi = 3.14159265358979323846;
  int columns_;
  double pixel_;
};

}  // namespace docdepth
