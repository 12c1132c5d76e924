#include "docdepth/dynamics/range_image.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace docdepth {
namespace {

constexpr float kEmpty = std::numeric_limits<float>::infinity();

}  // namespace

RangeImage::RangeImage(const Points& points, const bool* ground,
                       const RangeImageParameters& parameters)
    : grid_(parameters.resolution),
      half_(parameters.window / 2),
      tolerance_(parameters.tolerance),
      stride_(grid_.columns() + 2 * half_) {
  if (parameters.window < 1 || parameters.window % 2 == 0)
    throw std::invalid_argument("the window must be an odd number of pixels");
  if (!(tolerance_ > 0.0f)) throw std::invalid_argument("the range tolerance must be above zero");

  struct Return {
    int row, column;
    float range;
    bool ground;
  };
  std::vector<Return> returns;
  returns.reserve(points.rows());
  int last_row = -1;
  first_row_ = grid_.rows();
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const float x = points(i, 0), y = points(i, 1), z = points(i, 2);
    const float range = range_of(x, y, z);
    if (!(range > 0.0f && range < kEmpty)) continue;
    returns.push_back({grid_.row(z, range), grid_.column(x, y), range, ground[i]});
    first_row_ = std::min(first_row_, returns.back().row);
    last_row = std::max(last_row, returns.back().row);
  }
  rows_ = std::max(0, last_row - first_row_ + 1);

  range_.assign((rows_ + 4 * half_) * stride_, kEmpty);
  ground_.assign(range_.size(), 0);
  for (const Return& r : returns) {
    const std::size_t pixel = (r.row - first_row_ + 2 * half_) * stride_ + r.column + half_;
    if (r.range < range_[pixel]) {
      range_[pixel] = r.range;
      ground_[pixel] = r.ground;
    }
  }
  // The window wraps around: repeat the columns of either end beyond the other one.
  for (std::size_t row = 0; row < range_.size(); row += stride_) {
    for (int k = 0; k < half_; ++k) {
      const std::size_t left = row + k, right = row + half_ + grid_.columns() + k;
      range_[left] = range_[left + grid_.columns()];
      range_[right] = range_[right - grid_.columns()];
    }
  }
}

bool RangeImage::find(int row, int column, std::size_t* pixel) const {
  const int image_row = row - first_row_ + 2 * half_;
  if (image_row < half_ || image_row >= rows_ + 3 * half_) return false;
  *pixel = image_row * stride_ + column + half_;
  return true;
}

RangeImage::Vote RangeImage::ask(float range, std::size_t pixel) const {
  const bool centre_ground = ground_[pixel];
  const float tolerance = centre_ground ? 0.0f : tolerance_;
  Vote vote = Vote::kNone;
  for (int row = -half_; row <= half_; ++row) {
    const float* image = &range_[pixel + row * static_cast<std::ptrdiff_t>(stride_)];
    for (int column = -half_; column <= half_; ++column) {
      if (image[column] == kEmpty) continue;
      const float difference = range - image[column];
      if (std::fabs(difference) < tolerance) return Vote::kStatic;
      if (difference < -tolerance) {
        vote = Vote::kDynamic;
      } else if (!centre_ground) {
        return Vote::kNone;
      }
    }
  }
  return vote;
}

void RangeImage::vote(const QueryPoints& points, std::uint16_t* statics,
                      std::uint16_t* dynamics) const {
  for (std::size_t i = 0; i < points.size; ++i) {
    const int row = grid_.row(points.z[i], points.range[i]);
    std::size_t pixel;
    if (!find(row, grid_.column(points.x[i], points.y[i]), &pixel)) continue;
    const Vote vote = ask(points.range[i], pixel);
    statics[i] += vote == Vote::kStatic;
    dynamics[i] += vote == Vote::kDynamic;
  }
}

}  // namespace docdepth
