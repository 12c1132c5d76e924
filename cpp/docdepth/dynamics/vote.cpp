#include <cmath>
#include <stdexcept>

#include "docdepth/dynamics/key_frame.hpp"
#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/rigid.hpp"
#include "docdepth/geometry/spherical.hpp"

namespace docdepth {
namespace {

// Small enough for a block and its scratch to stay in the second level cache, large enough to read
// each key frame's image many times before going to the next.
constexpr std::size_t kBlock = 8192;

/// The points of one block that are voted on, column by column.
struct Columns {
  std::vector<float> x, y, z, range;

  explicit Columns(std::size_t size) : x(size), y(size), z(size), range(size) {}
};

void move_points(const Columns& from, std::size_t size, const RigidTransform& T, Columns& to) {
  for (std::size_t i = 0; i < size; ++i) {
    const Eigen::Vector3f p = T * Eigen::Vector3f(from.x[i], from.y[i], from.z[i]);
    to.x[i] = p.x();
    to.y[i] = p.y();
    to.z[i] = p.z();
    to.range[i] = range_of(p.x(), p.y(), p.z());
  }
}

// Farther than any sensor measures, and still far from overflow.
constexpr float kNowhere = 1e18f;

/// Neither at the origin nor NaN nor infinite.
bool usable(float range) {
  return range > 0.0f && range < kNowhere;
}

/// Move points that lie at the origin of a key frame to where no sensor measures, so that key
/// frames need not look out for points without a direction.
void hide_unusable(std::size_t size, Columns& points) {
  for (std::size_t i = 0; i < size; ++i) {
    if (usable(points.range[i])) continue;
    points.x[i] = points.y[i] = 0.0f;
    points.z[i] = points.range[i] = kNowhere;
  }
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
    Columns query(end - begin), moved(end - begin);
    std::vector<std::size_t> index;
    for (std::size_t i = begin; i < end; ++i) {
      if (ground[i] || !usable(range_of(points(i, 0), points(i, 1), points(i, 2)))) continue;
      query.x[index.size()] = points(i, 0);
      query.y[index.size()] = points(i, 1);
      query.z[index.size()] = points(i, 2);
      index.push_back(i);
    }
    std::vector<std::uint16_t> statics(index.size()), dynamics(index.size());
    for (std::size_t k = 0; k < key_frames.size(); ++k) {
      move_points(query, index.size(), T_key_query[k], moved);
      hide_unusable(index.size(), moved);
      key_frames[k]->vote(
          {index.size(), moved.x.data(), moved.y.data(), moved.z.data(), moved.range.data()},
          statics.data(), dynamics.data());
    }
    for (std::size_t i = 0; i < index.size(); ++i) {
      votes.statics[index[i]] = statics[i];
      votes.dynamics[index[i]] = dynamics[i];
    }
  });
  return votes;
}

}  // namespace docdepth
