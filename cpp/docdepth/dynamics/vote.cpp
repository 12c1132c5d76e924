#include <algorithm>
#include <stdexcept>

#include "docdepth/dynamics/key_frame.hpp"
#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/rigid.hpp"
#include "docdepth/geometry/simd.hpp"
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

  std::size_t size() const { return index.size(); }
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

/// The usable points of rows [begin, end) that are ground, or those that are not.
Columns select(const Points& points, const bool* ground, bool of_ground, std::size_t begin,
               std::size_t end) {
  Columns columns;
  for (auto* values : {&columns.x, &columns.y, &columns.z}) values->resize(end - begin);
  columns.index.resize(end - begin);
  std::size_t count = 0;
  for (std::size_t i = begin; i < end; ++i) {
    const float x = points(i, 0), y = points(i, 1), z = points(i, 2);
    columns.x[count] = x;
    columns.y[count] = y;
    columns.z[count] = z;
    columns.index[count] = i;
    count += (ground[i] == of_ground) & usable(range_of(x, y, z));
  }
  for (auto* values : {&columns.x, &columns.y, &columns.z}) values->resize(count);
  columns.index.resize(count);
  return columns;
}

/// Points of a block on their way through a key frame.
class Group {
 public:
  /// Move the points from `begin` on to the key frame and find their pixels.
  void find(const Columns& query, std::size_t begin, const KeyFrame& key_frame,
            const RigidTransform& T_key_query, bool ground) {
    key_frame_ = &key_frame;
    begin_ = begin;
    ground_ = ground;
    size_ = std::min(QueryPoints::kMax, query.size() - begin);
    dispatch<MovePoints>(size_, &query.x[begin], &query.y[begin], &query.z[begin], T_key_query, x_,
                         y_, z_, range_);
    key_frame.find(points(), pixels_);
  }
  void vote(std::uint16_t* statics, std::uint16_t* dynamics) const {
    key_frame_->vote(points(), pixels_, statics + begin_, dynamics + begin_);
  }

 private:
  QueryPoints points() const { return {size_, x_, y_, z_, range_, ground_}; }

  const KeyFrame* key_frame_;
  std::size_t begin_, size_;
  bool ground_;
  float x_[QueryPoints::kMax], y_[QueryPoints::kMax], z_[QueryPoints::kMax],
      range_[QueryPoints::kMax];
  std::int32_t pixels_[QueryPoints::kMax];
};

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

  const auto vote_on = [&](const Columns& query, bool of_ground) {
    std::vector<std::uint16_t> statics(query.size()), dynamics(query.size());
    const std::size_t groups = (query.size() + QueryPoints::kMax - 1) / QueryPoints::kMax;
    Group found[2];
    for (std::size_t n = 0; n <= groups * key_frames.size(); ++n) {
      Group& next = found[n % 2];
      const Group& last = found[1 - n % 2];
      if (n < groups * key_frames.size())
        next.find(query, n % groups * QueryPoints::kMax, *key_frames[n / groups],
                  T_key_query[n / groups], of_ground);
      if (n > 0) last.vote(statics.data(), dynamics.data());
    }
    for (std::size_t i = 0; i < query.size(); ++i) {
      votes.statics[query.index[i]] = statics[i];
      votes.dynamics[query.index[i]] = dynamics[i];
    }
  };
  const bool with_ground = !key_frames.empty() && key_frames.front()->asks_ground();
  parallel_for(count, kBlock, threads, [&](std::size_t begin, std::size_t end) {
    vote_on(select(points, ground, false, begin, end), false);
    if (with_ground) vote_on(select(points, ground, true, begin, end), true);
  });
  return votes;
}

}  // namespace docdepth
