// A key frame as the range image of the paper (IV-C, Algorithm 1).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/voting/key_frame.hpp"
#include "docdepth/voting/padded_range_image.hpp"

namespace docdepth {

/// Parameters of Algorithm 1.
struct RangeImageParameters {
  double resolution = kImageResolution;  ///< pixel size [rad]
  int window = kWindow;                  ///< edge of the window, w of the paper [pixel]; odd
  float tolerance = kRangeTolerance;     ///< range tolerance, tau of the paper [m]
};

/// The nearest return of each pixel, and whether that is ground.
class RangeImage : public KeyFrame {
 public:
  /// Points that are not finite or lie at the origin are left out.
  /// @param ground  one flag per point
  RangeImage(const Points& points, const bool* ground, const RangeImageParameters& parameters);

  void find(const QueryPoints& points, std::int32_t* pixels) const override;
  bool votes_on_ground() const override { return false; }

  /// Algorithm 1 on every point.
  void vote(const QueryPoints& points, const std::int32_t* pixels, std::uint16_t* static_votes,
            std::uint16_t* dynamic_votes) const override;

 private:
  enum class Vote { kNone, kStatic, kDynamic };

  void draw(const Points& points, const bool* ground);
  void summarize_windows();
  Vote vote_at(float range, std::size_t pixel) const;

  PaddedRangeImage padded_;
  float tolerance_;                   ///< [m]
  std::vector<float> range_;          ///< nearest return [m], or kEmpty
  std::vector<std::uint8_t> ground_;  ///< whether that is ground

  /// The ranges between which points of a pixel are static, which decide almost all votes without a
  /// look at the window. Nearer than all spans a point is dynamic, elsewhere it has no vote. The
  /// far end of a span is in the upper half of the integer, the near end in the lower one.
  using Spans = std::array<std::uint32_t, 4>;
  std::vector<Spans> spans_;
};

}  // namespace docdepth
