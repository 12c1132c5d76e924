// The pixel layout of a key frame's images.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "docdepth/geometry/spherical.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/voting/key_frame.hpp"

namespace docdepth {

/// Pixel size of the images [rad]: 0.2 degrees, d_theta = d_phi of the paper.
constexpr double kImageResolution = 0.2 * 3.14159265358979323846 / 180.0;
/// Edge of the window around a pixel [pixel]: w of the paper (IV-D).
constexpr int kWindow = 5;
/// Range tolerance of a return [m]: tau of the paper (IV-D).
constexpr float kRangeTolerance = 0.2f;
/// Range of a pixel without a return.
constexpr float kEmpty = std::numeric_limits<float>::infinity();

/// The returns of a sweep, one column per coordinate. Points that are not finite or lie at the
/// origin are left out.
struct Returns {
  std::vector<float> x, y, z, range;
  std::vector<std::uint32_t> number;  ///< row of the sweep

  explicit Returns(const Points& points);
  std::size_t size() const { return range.size(); }
};

/// The occupied rows of a spherical grid, padded so that windows need no bounds.
///
/// Empty rows above and below are as many as windows reach. Some columns of either end are repeated
/// beyond the other end, so that windows need not wrap around.
class PaddedRangeImage {
 public:
  /// @param half  pixels of a window on either side of its centre
  PaddedRangeImage(double resolution, int half);

  /// Fit the rows to the returns. Call it once.
  /// @return pixel of each return
  std::vector<std::int32_t> fit(const Returns& returns);

  /// Pixels of any points. Far above or below the returns they are in rows with empty windows.
  void find(const QueryPoints& points, std::int32_t* pixels) const;

  /// Copy the columns of either end of an image beyond the other end.
  template <class Value>
  void wrap(std::vector<Value>& image) const {
    for (std::size_t row = 0; row < image.size(); row += stride_) {
      for (int k = 0; k < half_; ++k) {
        image[row + k] = image[row + k + grid_.columns()];
        image[row + half_ + grid_.columns() + k] = image[row + half_ + k];
      }
    }
  }

  /// Range of the nearest return of each pixel, or kEmpty; wrapped.
  /// @param nearest  receives its index in `returns`, if not null
  std::vector<float> nearest_ranges(const Returns& returns, const std::vector<std::int32_t>& pixels,
                                    std::vector<std::uint32_t>* nearest = nullptr) const;

  /// Minimum and maximum in the window around each pixel of an image. Pixels whose windows are not
  /// within it become 0, or are not valid at the ends of rows.
  std::vector<float> window_minimum(const std::vector<float>& image) const;
  std::vector<float> window_maximum(const std::vector<float>& image) const;

  /// The first corner of the window of pixel p is at this address + p.
  const float* corner(const std::vector<float>& image) const {
    return image.data() - half_ * (stride_ + 1);
  }

  const SphericalGrid& grid() const { return grid_; }
  int half() const { return half_; }
  int top() const { return top_; }                ///< row of the grid that is the first row here
  int rows() const { return rows_; }              ///< with padding
  std::size_t stride() const { return stride_; }  ///< columns, with padding
  std::size_t size() const { return rows_ * stride_; }

 private:
  SphericalGrid grid_;
  int half_;
  int top_ = 0;
  int rows_ = 0;
  std::size_t stride_;
};

}  // namespace docdepth
