// A key frame as the paper's range image (III-C2, Algorithm 1).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "docdepth/dynamics/key_frame.hpp"
#include "docdepth/dynamics/padded_range_image.hpp"

namespace docdepth {

/// Parameters of Algorithm 1.
struct RangeImageParameters {
  double resolution = 0.2 * 3.14159265358979323846 / 180.0;  ///< pixel, d_theta = d_phi [rad]
  int window = 5;                                            ///< edge w [pixel], odd
  float tolerance = 0.2f;                                    ///< tau [m]
  bool plain = false;  ///< vote by the plain loop, the reference that the fast way must equal
};

/// For each pixel the nearest return and whether that one is ground.
class RangeImage : public KeyFrame {
 public:
  /// @param ground  one flag a point.
  /// Points that are not finite or lie at the origin are left out.
  RangeImage(const Points& points, const bool* ground, const RangeImageParameters& parameters);

  void find(const QueryPoints& points, std::int32_t* pixels) const override;
  bool asks_ground() const override { return false; }

  /// Algorithm 1 on every point.
  void vote(const QueryPoints& points, const std::int32_t* pixels, std::uint16_t* statics,
            std::uint16_t* dynamics) const override;

 private:
  enum class Vote { kNone, kStatic, kDynamic };

  void draw(const Points& points, const bool* ground);
  void summarize_windows();
  void vote_plainly(const QueryPoints& points, std::uint16_t* statics,
                    std::uint16_t* dynamics) const;
  Vote ask(float range, std::size_t pixel) const;

  PaddedRangeImage padded_;
  float tolerance_;  ///< tau
  bool plain_;
  std::vector<float> range_;          ///< nearest return, infinite where there is none
  std::vector<std::uint8_t> ground_;  ///< whether that is ground

  /// What settles almost all votes on the points of a pixel without looking at its window: between
  /// what ranges they are static. Before all spans they are dynamic, elsewhere they have no vote.
  /// The far end of a span is in the upper half, the near one in the lower.
  using Spans = std::array<std::uint32_t, 4>;
  std::vector<Spans> spans_;
};

}  // namespace docdepth
