#include <algorithm>
#include <stdexcept>

#include "docdepth/dynamics/key_frame.hpp"
#include "docdepth/geometry/dispatch.hpp"
#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/rigid.hpp"
#include "docdepth/geometry/spherical.hpp"

namespace docdepth {
namespace {

// Small enough for the points of a block to stay in the second level cache while all key frames are
// asked, large enough to read much of each key frame's image before going to the next.
constexpr std::size_t kBlock = 8192;

/// The points of one block that are voted on, a column each, and their rows in the sweep.
struct Columns {
  std::vector<float> x, y, z;
  std::vector<std::size_t> index;
};

// Farther than any sensor measures, and still far from overflow.
constexpr float kNowhere = 1e18f;

/// Neither at the origin nor NaN nor infinite.
inline bool usable(float range) {
  return (range > 0.0f) & (range < kNowhere);
}

/// Take points to another frame. Those that lie at its origin are moved to where no sensor
/// measures, so that key frames need not look out for points without a direction.
struct MovePoints {
  DOCDEPTH_KERNEL static void run(std::size_t count, const float* x, const float* y, const float* z,
                                  RigidTransform t, float* __restrict x_to, float* __restrict y_to,
                                  float* __restrict z_to, float* __restrict range) {
    for (std::size_t i = 0; i < count; ++i) {
      const float px = ((t.r[0][0] * x[i] + t.r[0][1] * y[i]) + t.r[0][2] * z[i]) + t.t[0];
      const float py = ((t.r[1][0] * x[i] + t.r[1][1] * y[i]) + t.r[1][2] * z[i]) + t.t[1];
      const float pz = ((t.r[2][0] * x[i] + t.r[2][1] * y[i]) + t.r[2][2] * z[i]) + t.t[2];
      const float rho = range_of(px, py, pz);
      const bool ok = usable(rho);
      x_to[i] = ok ? px : 0.0f;
      y_to[i] = ok ? py : 0.0f;
      z_to[i] = ok ? pz : kNowhere;
      range[i] = ok ? rho : kNowhere;
    }
  }
};

/// The points of rows [begin, end) that are neither ground nor unusable.
Columns select(const Points& points, const bool* ground, std::size_t begin, std::size_t end) {
  Columns columns;
  for (auto* values : {&columns.x, &columns.y, &columns.z}) values->reserve(end - begin);
  columns.index.reserve(end - begin);
  for (std::size_t i = begin; i < end; ++i) {
    const float x = points(i, 0), y = points(i, 1), z = points(i, 2);
    if (ground[i] || !usable(range_of(x, y, z))) continue;
    columns.x.push_back(x);
    columns.y.push_back(y);
    columns.z.push_back(z);
    columns.index.push_back(i);
  }
  return columns;
}

}  // namespace

Votes vote(const Points& points, const bool* ground, const Pose& T_world_lidar,
           const std::vector<const KeyFrame*>& key_frames, const std::vector<Pose>& T_world_key,
           int threads) {
  if (key_frames.size() != T_world_key.size())
    throw std::invalid_argument("each key frame needs one pose");
  const auto count = static_cast<std::size_t>(points.rows());
  Votes votes{std::vector<std::uint16_t>(count), std::vector<std::uint16_t>(count)};
  std::vector<RigidTransform> T_key_query;
  for (const Pose& pose : T_world_key) T_key_query.emplace_back(between(pose, T_world_lidar));

  parallel_for(count, kBlock, threads, [&](std::size_t begin, std::size_t end) {
    const Columns query = select(points, ground, begin, end);
    std::vector<std::uint16_t> statics(query.index.size()), dynamics(query.index.size());
    for (std::size_t k = 0; k < key_frames.size(); ++k) {
      float x[QueryPoints::kMax], y[QueryPoints::kMax], z[QueryPoints::kMax],
          range[QueryPoints::kMax];
      for (std::size_t i = 0; i < query.index.size(); i += QueryPoints::kMax) {
        const std::size_t size = std::min(QueryPoints::kMax, query.index.size() - i);
        dispatch<MovePoints>(size, &query.x[i], &query.y[i], &query.z[i], T_key_query[k], x, y, z,
                             range);
        key_frames[k]->vote({size, x, y, z, range}, &statics[i], &dynamics[i]);
      }
    }
    for (std::size_t i = 0; i < query.index.size(); ++i) {
      votes.statics[query.index[i]] = statics[i];
      votes.dynamics[query.index[i]] = dynamics[i];
    }
  });
  return votes;
}

}  // namespace docdepth
