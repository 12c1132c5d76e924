// The depths that several sweeps measured at a pixel, and which of them is true.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "docdepth/render/camera.hpp"
#include "docdepth/render/rays.hpp"
#include "docdepth/render/visibility_queries.hpp"

namespace docdepth {

/// Columns of an image of inverse depth, row after row; 0 where it is empty.
struct Columns {
  int begin, width, height, stride;

  std::size_t at(int u, int v) const { return std::size_t(v) * stride + u; }
};

/// Chooses between the depths of several sweeps.
///
/// The nearest sweep is taken as it is, except at its edges: near a depth jump and where it
/// measured nothing, every sweep adds its depth as a hypothesis. The nearest hypothesis that rays
/// confirm wins, else the nearest one that no ray tells about. At the edges of the result rays also
/// test whether a nearer surface covers the next pixel; what no ray confirms closely is left empty.
///
/// The camera stands beside the sensor and looks past a nearer surface where the sensor did not:
/// between its last return and the next ray. There what is farther is left empty if the rays that
/// passed nearest ended on the nearer surface.
class DepthHypotheses {
 public:
  static constexpr int kTile = 8;     ///< edge of the square tiles that are open or closed [pixel]
  static constexpr int kStrip = 104;  ///< columns whose edges are found without their neighbours
  static constexpr int kMost = kMostHypotheses;

  /// @param nearest    inverse depth of the nearest sweep
  /// @param extrapolated  of its surfaces beyond their last returns
  DepthHypotheses(const Columns& columns, std::vector<float> nearest,
                  std::vector<float> extrapolated);

  /// 1 for each tile, row after row, in which further sweeps are drawn.
  const std::vector<std::uint8_t>& open_tiles() const { return open_; }
  int tiles() const { return tiles_; }  ///< tiles in a row

  /// Add another sweep and clear its image in open tiles. Sweeps come in the order in which they
  /// win.
  void add(float* inverse_depth);

  /// Inverse depth as far as rays confirm it; without rays that of the first sweep that has any.
  std::vector<float> resolve(const Camera& camera, const std::vector<SweepRays>& rays) const;

 private:
  Columns columns_;
  int tiles_;
  std::vector<std::uint8_t> open_;
  std::vector<float> extrapolated_;
  std::vector<float> hypotheses_[kMost];  // each differs from those before it; 0 if there is none
};

/// Inverse depths of a dynamic object.
struct ObjectImages {
  std::vector<float> nearest;       ///< as the nearest sweep saw it
  std::vector<float> others;        ///< as other sweeps saw it
  std::vector<float> extrapolated;  ///< beyond what any sweep saw
};

/// Draw a dynamic object over what is farther: what the nearest sweep saw, what other sweeps saw if
/// rays do not contradict it, and what extrapolates it if rays confirm it. Between what rays
/// confirm and what they passed through, pixels stay empty.
/// @param bounds  of its pixels; columns as in `columns`
/// @param rays    placed so that the object stands still among them
/// @param number  of the object, from 1 on
/// @param shown_objects  number of the object that each pixel shows; 0 for none
void add_dynamic_object(const Columns& columns, const PixelBounds& bounds, const Camera& camera,
                        const ObjectImages& object, const std::vector<SweepRays>& rays,
                        std::uint16_t number, std::vector<float>& inverse_depth,
                        std::vector<std::uint16_t>& shown_objects);

}  // namespace docdepth
