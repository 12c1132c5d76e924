// The pixels of a key frame's images.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "docdepth/dynamics/key_frame.hpp"
#include "docdepth/geometry/spherical.hpp"
#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// The returns of a sweep, a column each: rows that are not finite or lie at the origin left out.
struct Returns {
  std::vector<float> x, y, z, range;
  std::vector<std::uint32_t> number;  ///< row of the sweep

  explicit Returns(const Points& points);
  std::size_t size() const { return range.size(); }
};

/// The rows of the spherical grid that a sweep occupies, and as many empty ones around them as
/// windows there can reach. Images of that size repeat some columns of either end beyond the other
/// one, so that windows need not wrap around.
class PaddedRangeImage {
 public:
  /// @param half  pixels of a window on either side of its centre
  PaddedRangeImage(double resolution, int half);

  /// Fit the rows to the returns. Call it once.
  /// @return the pixel of each return
  std::vector<std::int32_t> fit(const Returns& returns);

  /// Pixels of points anywhere. What lies far above or below the returns goes to a row whose
  /// windows are empty.
  void find(const QueryPoints& points, std::int32_t* pixels) const;

  /// The same of one point, plainly; -1 where windows are empty.
  std::ptrdiff_t pixel(float x, float y, float z, float range) const;

  /// Copy the columns of either end of an image beyond the other one.
  template <class Value>
  void wrap(std::vector<Value>& image) const {
    for (std::size_t row = 0; row < image.size(); row += stride_) {
      for (int k = 0; k < half_; ++k) {
        image[row + k] = image[row + k + grid_.columns()];
        image[row + half_ + grid_.columns() + k] = image[row + half_ + k];
      }
    }
  }

  /// The nearest return of each pixel, infinite where there is none, wrapped.
  /// @param nearest  its place among the returns where asked for, else kept as it is
  std::vector<float> nearest_ranges(const Returns& returns, const std::vector<std::int32_t>& pixels,
                                    std::vector<std::uint32_t>* nearest = nullptr) const;

  /// The window of pixel p has its first corner there + p.
  const float* corner(const std::vector<float>& image) const {
    return image.data() - half_ * (stride_ + 1);
  }

  const SphericalGrid& grid() const { return grid_; }
  int half() const { return half_; }
  int top() const { return top_; }    ///< row of the grid that is the first of the images
  int rows() const { return rows_; }  ///< rows of the images
  std::size_t stride() const { return stride_; }  ///< columns, the repeated ones included
  std::size_t size() const { return rows_ * stride_; }

 private:
  SphericalGrid grid_;
  int half_;
  int top_ = 0;
  int rows_ = 0;
  std::size_t stride_;
};

}  // namespace docdepth
