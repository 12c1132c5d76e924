#include "docdepth/render/cloud.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "docdepth/render/identity.hpp"

namespace docdepth {
namespace {

constexpr std::uint32_t kSectors = 64, kRings = 128;

/// Cell of a point around the sensor: equal sectors of azimuth, rings that grow with range.
/// Consecutive cells are neighbours, so blocks of points are compact.
std::uint32_t cell(float x, float y) {
  const float sum = std::abs(x) + std::abs(y);
  // The diamond angle, 0 to 4, grows with azimuth and needs no trigonometry.
  float angle = sum > 0 ? x / sum : 0.0f;
  angle = y < 0 ? 3.0f + angle : 1.0f - angle;
  const auto sector = std::min(static_cast<std::uint32_t>(angle * (kSectors / 4.0f)), kSectors - 1);
  // Exponent and two bits of the squared range: rings a tenth of their range wide.
  const float squared = std::min(x * x + y * y + 1.0f, 1e9f);
  const std::uint32_t ring =
      std::min((std::bit_cast<std::uint32_t>(squared) >> 21) - (127u << 2), kRings - 1);
  return sector * kRings + ring;
}

}  // namespace

Cloud::Cloud(const Points& points, const std::vector<std::uint8_t>& keep,
             const std::uint16_t* classid) {
  id_ = new_identity();
  std::vector<std::uint32_t> cells(points.rows()), start(kSectors * kRings + 1, 0);
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    if (!keep[i]) continue;
    cells[i] = cell(points(i, 0), points(i, 1));
    ++start[cells[i] + 1];
  }
  for (std::size_t c = 1; c < start.size(); ++c) start[c] += start[c - 1];
  const std::uint32_t count = start.back();
  std::vector<std::uint32_t> sector_end;
  for (std::uint32_t s = 1; s <= kSectors; ++s) sector_end.push_back(start[s * kRings]);

  for (auto* axis : {&x_, &y_, &z_}) axis->resize(count + kPadding);
  classes_.resize(count);
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    if (!keep[i]) continue;
    const std::uint32_t at = start[cells[i]]++;
    x_[at] = points(i, 0);
    y_[at] = points(i, 1);
    z_[at] = points(i, 2);
    classes_[at] = classid ? class_of(classid[i]) : std::uint8_t{kGround};
  }

  Eigen::Vector3f low = Eigen::Vector3f::Constant(INFINITY), high = -low;
  std::uint32_t begin = 0;
  for (const std::uint32_t sector : sector_end) {
    while (begin < sector) {
      const std::uint32_t end = std::min(begin + kBlock, sector);
      Eigen::Vector3f block_low(x_[begin], y_[begin], z_[begin]), block_high = block_low;
      for (std::uint32_t i = begin; i < end; ++i) {
        block_low = block_low.cwiseMin(Eigen::Vector3f(x_[i], y_[i], z_[i]));
        block_high = block_high.cwiseMax(Eigen::Vector3f(x_[i], y_[i], z_[i]));
      }
      blocks_.push_back({Box::around(block_low, block_high), begin, end});
      low = low.cwiseMin(block_low);
      high = high.cwiseMax(block_high);
      begin = end;
    }
  }
  if (count) box_ = Box::around(low, high);
}

Frame::Frame(const Points& points, const std::uint16_t* classid, double crop) {
  std::vector<std::uint8_t> keep_static(points.rows()), keep_dynamic(points.rows());
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const double x = points(i, 0), y = points(i, 1), z = points(i, 2);
    const bool inside = x * x + y * y + z * z < crop * crop;  // false for NaN
    keep_static[i] = inside && classid[i] < kDynamic;
    keep_dynamic[i] = inside && classid[i] >= kDynamic;
  }
  static_points = Cloud(points, keep_static, classid);
  dynamic_points = Cloud(points, keep_dynamic, classid);
}

}  // namespace docdepth
