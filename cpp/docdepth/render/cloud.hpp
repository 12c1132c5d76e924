// The points of a sweep in blocks of neighbours, so that blocks outside the view are skipped.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"

namespace docdepth {

/// Points in blocks of neighbours, each with its box. One column per coordinate.
class Cloud {
 public:
  static constexpr std::uint32_t kBlock = 256;   ///< most points in a block
  static constexpr std::uint32_t kPadding = 16;  ///< values that may be read behind the last point

  struct Block {
    Box box;
    std::uint32_t begin, end;
  };

  Cloud() = default;

  /// @param keep     0 for points that are left out; all others must be finite
  /// @param classid  ClassId of every point; ground if null
  Cloud(const Points& points, const std::vector<std::uint8_t>& keep,
        const std::uint16_t* classid = nullptr);

  std::size_t size() const { return blocks_.empty() ? 0 : blocks_.back().end; }
  std::uint64_t id() const { return id_; }  ///< see new_identity()
  const Box& box() const { return box_; }
  const std::vector<Block>& blocks() const { return blocks_; }
  const float* x() const { return x_.data(); }
  const float* y() const { return y_.data(); }
  const float* z() const { return z_.data(); }
  const std::uint8_t* classes() const { return classes_.data(); }  ///< ClassId

 private:
  std::uint64_t id_ = 0;
  Box box_{};
  std::vector<Block> blocks_;
  std::vector<float> x_, y_, z_;
  std::vector<std::uint8_t> classes_;
};

/// A sweep made ready to be drawn as splats. Dynamic points are drawn from one sweep, static points
/// from many.
struct Frame {
  Cloud static_points, dynamic_points;

  /// @param classid  ClassId of every point
  /// @param crop     points at this range and beyond are left out [m]
  Frame(const Points& points, const std::uint16_t* classid, double crop);
};

}  // namespace docdepth
