// The rays of a sweep: where each ended on a surface, and what space it passed through.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "docdepth/geometry/types.hpp"
#include "docdepth/mesh/directions.hpp"
#include "docdepth/render/constants.hpp"

namespace docdepth {

/// Up to kMax points, one column per coordinate.
struct PointBatch {
  static constexpr std::size_t kMax = 256;
  std::size_t size = 0;
  float x[kMax], y[kMax], z[kMax];
};

/// Azimuths from `first` on, which go round the seam [units of kTurn].
struct Sector {
  std::int32_t first = -kTurn / 2, span = kTurn;
};

/// The returns of a sweep, sorted by the direction of their rays.
class Rays {
 public:
  Rays() = default;

  /// @param normals      of the surface at each point, of any length; zero if unknown
  /// @param ray_origins  where each ray starts, near the origin; null for the origin itself
  /// @param sector       azimuths of all rays
  /// @param time_offset  when each was measured [s after the sweep's stamp]; null for the stamp
  /// @param moving       1 if it ended on a dynamic object; null if none did
  Rays(const Points& points, const std::vector<Eigen::Vector3f>& normals,
       const Points* ray_origins = nullptr, const Sector& sector = {},
       const float* time_offset = nullptr, const std::uint8_t* moving = nullptr);

  /// Add the score of the nearest ray to the score of each point (frame of the sweep).
  ///
  /// The score is 1 / (distance + blur)^2: positive if the ray ended on a surface at the point,
  /// negative if it passed through, zero if it ended before or no ray is near.
  void query_visibility(const PointBatch& points, float blur, float* scores) const;

  /// The end of a ray.
  struct End {
    Eigen::Vector3f plane;  ///< of the surface there: plane . x = 1
    float range;            ///< [m]
  };

  /// Rays in cells of direction, column after column.
  struct Cells {
    int side = 1, columns = 0, rows = 0, low = 0;  ///< angles in units of kTurn; columns of a turn
    int first = 0, used = 0;                       ///< columns that have rays, round the seam
    std::vector<std::uint32_t> start;              ///< first ray of each cell, and the end
    // Eight values may be read behind the last ray.
    std::vector<float> azimuth, elevation;  ///< of each ray; integers
    std::vector<float> left, up;            ///< offset of the ray's origin [units * m]
    std::vector<End> ends;
    std::vector<float> time;  ///< of each ray [s after the sweep's stamp]
    /// Of the first and the last ray; infinite without rays.
    float first_time = std::numeric_limits<float>::infinity(), last_time = -first_time;
    std::vector<std::uint8_t> moving;  ///< 1 if the ray ended on a dynamic object

    float spacing() const;  ///< mean distance between returns [rad]
    /// Where a column is kept; `used` if it is not.
    int place(int column) const {
      const int after = column < first ? column - first + columns : column - first;
      return std::min(after, used);
    }
  };

  const Cells& cells() const { return cells_; }

 private:
  void make_cells(const std::vector<std::uint32_t>& rows, int low, int high, const Sector& sector);

  Cells cells_;
};

/// Rays in the frame of the camera at the time of the image.
struct SweepRays {
  const Rays* rays;
  Pose T_camera_rays;
  float blur = kRayBlur;  ///< how exactly their position is known [m]
  float age = 0;          ///< from the sweep's stamp to the image [s]
};

}  // namespace docdepth
