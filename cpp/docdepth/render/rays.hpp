// What the rays of a sweep met, and what they went through on their way.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// Some places, coordinate by coordinate.
struct Places {
  static constexpr std::size_t kMost = 256;
  std::size_t size = 0;
  float x[kMost], y[kMost], z[kMost];
};

constexpr float kBlur = 0.02f;  ///< no ray is known better than this [m]

/// The returns of a sweep by the direction of their lines of sight.
class Rays {
 public:
  Rays() = default;

  /// @param normals of the surface at each point, of any length; zero where there is none
  /// @param starts where the line of sight of each point begins, near the origin; may be null
  Rays(const Points& points, const std::vector<Eigen::Vector3f>& normals,
       const Points* starts = nullptr);

  /// Adds to each balance what the ray that passed nearest to a place, in the frame of the sweep,
  /// tells of it: more than 0 if it met a surface there, less if it went on, nothing if it ended
  /// before or no ray came near. The nearer it passed the more it counts: 1 / (distance + blur)^2.
  void ask(const Places& places, float blur, float* balance) const;

  /// Where a ray ended.
  struct End {
    Eigen::Vector3f plane;  ///< of the surface there: plane . x = 1
    float range;
  };

  /// Returns in cells of direction, column after column.
  struct Cells {
    int side = 1, columns = 0, rows = 0, low = 0;  ///< angles in units of kTurn
    std::vector<std::uint32_t> start;              ///< of each cell, and the end
    std::vector<float> azimuth, elevation;         ///< of each line of sight; whole numbers
    std::vector<float> left, up;                   ///< of the origin it passes [units * m]
    std::vector<End> ends;
  };

 private:
  Cells cells_;
};

/// A sweep's rays where it stood relative to the camera at the image's time.
struct PlacedRays {
  const Rays* rays;
  Pose T_camera_rays;
  float blur = kBlur;  ///< how well it is known where they passed [m]
};

}  // namespace docdepth
