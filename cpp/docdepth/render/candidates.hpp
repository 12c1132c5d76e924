// What the sweeps offer for a pixel, and which of it is true.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/rays.hpp"

namespace docdepth {

/// Columns of an image, row after row: `nearness[v * stride + u]` is 1 / depth, 0 where it is
/// empty.
struct Columns {
  int begin, width, height, stride;

  std::size_t at(int u, int v) const { return std::size_t(v) * stride + u; }
};

/// The nearest sweep is trusted, but not at its edges: near a depth jump and where it measured
/// nothing, all sweeps offer what they have. Of different offers for a pixel, the nearest is taken
/// that more rays met than went through, else the nearest of which none tells. Where the result has
/// an edge, rays are asked for the nearest surface beside a pixel, too, and what none of them met
/// closely is left empty.
class Candidates {
 public:
  static constexpr int kTile = 8;     ///< edge of the squares of pixels that are open or not
  static constexpr int kStrip = 104;  ///< columns that know nothing of those beside them
  static constexpr int kMost = 3;     ///< offers that are kept for a pixel

  Candidates(const Columns& columns, std::vector<float> trusted);

  /// Of each tile, row after row, 1 where the sweeps are to offer what they have.
  const std::vector<std::uint8_t>& open_tiles() const { return open_; }
  int tiles() const { return tiles_; }  ///< in a row

  /// One more sweep, by falling trust. Clears it where tiles are open.
  void take(float* nearness);

  /// The nearness that is true, as far as `rays` know; without any, that of the first offer.
  std::vector<float> settle(const Camera& camera, const std::vector<PlacedRays>& rays) const;

 private:
  Columns columns_;
  int tiles_;
  std::vector<std::uint8_t> open_;
  std::vector<float> offers_[kMost];  // each differs from those before it; 0 from the first unused
};

/// Draws a moving object over what is farther. What its trusted surface leaves empty the others
/// fill: there the rays that saw it decide. It is drawn where they met it close by, what is behind
/// it where they surely passed. Between these nobody knows, since what moves is not rigid, and
/// pixels stay empty.
void add_mover(const Columns& columns, const Camera& camera, const std::vector<float>& trusted,
               const std::vector<float>& others, const std::vector<PlacedRays>& rays,
               std::vector<float>& nearness);

}  // namespace docdepth
