#include <algorithm>
#include <stdexcept>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/rigid.hpp"
#include "docdepth/geometry/simd.hpp"
#include "docdepth/geometry/spherical.hpp"
#include "docdepth/voting/key_frame.hpp"
#include "docdepth/voting/padded_range_image.hpp"

namespace docdepth {
namespace {

/// Larger ranges are no measurements [m]. Points without a direction are moved there; it is far
/// from overflow.
constexpr float kUnmeasured = 1e18f;
/// Points of a block. Its columns stay in the second level cache while all key frames vote, and it
/// reads much of each image before it goes to the next one.
constexpr std::size_t kVoteBlock = 8192;
/// The points of a block that get votes, one column per coordinate, and their rows in the sweep.
struct BlockPoints {
  std::vector<float> x, y, z;
  std::vector<std::size_t> index;

  std::size_t size() const { return index.size(); }
};

/// Neither at the origin nor NaN nor infinite.
inline bool usable(float range) {
  return (range > 0.0f) & (range < kUnmeasured);
}

/// Moves points to another frame. Points at its origin are moved to kUnmeasured, so that key frames
/// need not handle points without a direction.
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
      z_to[i] = ok ? pz : kUnmeasured;
      range[i] = ok ? rho : kUnmeasured;
    }
  }
};

/// The usable points of rows [begin, end) that are ground, or that are not.
BlockPoints select(const Points& points, const bool* ground, bool of_ground, std::size_t begin,
                   std::size_t end) {
  BlockPoints columns;
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

/// A batch of points in the frame of a key frame.
class Batch {
 public:
  /// Move the points from `begin` on to the key frame and find their pixels there.
  void find(const BlockPoints& query, std::size_t begin, const KeyFrame& key_frame,
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

  std::size_t begin() const { return begin_; }
  std::size_t end() const { return begin_ + size_; }

 private:
  QueryPoints points() const { return {size_, x_, y_, z_, range_, ground_}; }

  const KeyFrame* key_frame_;
  std::size_t begin_, size_;
  bool ground_;
  float x_[QueryPoints::kMax], y_[QueryPoints::kMax], z_[QueryPoints::kMax],
      range_[QueryPoints::kMax];
  std::int32_t pixels_[QueryPoints::kMax];
};

/// No road user is where another one was so soon before [s]: not even in dense traffic.
constexpr double kMinHeadway = 1;

/// The votes on points so far, and what they say in order of time.
struct Tally {
  std::vector<std::uint16_t> statics, dynamics, seen_statics, seen_dynamics, first, last;
  std::vector<std::uint8_t> was_occupied, was_left;  ///< was_left: free since it was occupied
  std::vector<std::uint8_t> in_turn, porous;
  std::vector<float> time;  ///< when it was occupied last [s after the sweep]

  explicit Tally(std::size_t count)
      : statics(count),
        dynamics(count),
        seen_statics(count),
        seen_dynamics(count),
        first(count, Votes::kNever),
        last(count, Votes::kNever),
        was_occupied(count),
        was_left(count),
        in_turn(count),
        porous(count),
        time(count) {}

  /// Take note of the votes of a key frame on [begin, end).
  /// @param seconds  of it, after the sweep
  void note(std::size_t begin, std::size_t end, std::uint16_t key_frame, float seconds) {
    for (std::size_t i = begin; i < end; ++i) {
      const bool occupied = statics[i] != seen_statics[i], free = dynamics[i] != seen_dynamics[i];
      seen_statics[i] = statics[i];
      seen_dynamics[i] = dynamics[i];
      if (occupied) {
        note_occupied(i, seconds);
        if (first[i] == Votes::kNever) first[i] = key_frame;
        last[i] = key_frame;
      }
      was_left[i] |= free & was_occupied[i];
    }
  }
  /// The sweep itself found all its points occupied.
  void note_sweep(std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) note_occupied(i, 0);
  }

 private:
  void note_occupied(std::size_t i, float seconds) {
    in_turn[i] |= was_left[i];
    porous[i] |= was_left[i] & (seconds - time[i] <= float(kMinHeadway));
    was_occupied[i] = 1;
    was_left[i] = 0;
    time[i] = seconds;
  }
};

}  // namespace

Votes vote(const Points& points, const bool* ground, const Pose& T_world_lidar,
           const std::vector<const KeyFrame*>& key_frames, const std::vector<Pose>& T_world_key,
           const std::vector<double>& seconds, int threads) {
  if (key_frames.size() != T_world_key.size() || key_frames.size() != seconds.size())
    throw std::invalid_argument("vote needs one pose and one time for each key frame");
  const auto count = static_cast<std::size_t>(points.rows());
  Votes votes{std::vector<std::uint16_t>(count),
              std::vector<std::uint16_t>(count),
              std::vector<std::uint8_t>(count),
              std::vector<std::uint8_t>(count),
              std::vector<std::uint16_t>(count, Votes::kNever),
              std::vector<std::uint16_t>(count, Votes::kNever)};
  const auto is_earlier = [](double of) { return of < 0; };
  const auto earlier = std::size_t(std::count_if(seconds.begin(), seconds.end(), is_earlier));
  std::vector<RigidTransform> T_key_query;
  for (const Pose& pose : T_world_key) T_key_query.emplace_back(between(pose, T_world_lidar));

  const auto vote_on = [&](const BlockPoints& query, bool of_ground) {
    Tally tally(query.size());
    const std::size_t batch_count = (query.size() + QueryPoints::kMax - 1) / QueryPoints::kMax;
    Batch batches[2];
    for (std::size_t n = 0; n <= batch_count * key_frames.size(); ++n) {
      Batch& next = batches[n % 2];
      const Batch& last = batches[1 - n % 2];
      if (n < batch_count * key_frames.size())
        next.find(query, n % batch_count * QueryPoints::kMax, *key_frames[n / batch_count],
                  T_key_query[n / batch_count], of_ground);
      if (n == 0) continue;
      last.vote(tally.statics.data(), tally.dynamics.data());
      const std::size_t k = (n - 1) / batch_count;
      if (k == earlier) tally.note_sweep(last.begin(), last.end());
      tally.note(last.begin(), last.end(), std::uint16_t(k), float(seconds[k]));
    }
    if (earlier >= key_frames.size()) tally.note_sweep(0, query.size());
    for (std::size_t i = 0; i < query.size(); ++i) {
      votes.statics[query.index[i]] = tally.statics[i];
      votes.dynamics[query.index[i]] = tally.dynamics[i];
      votes.occupied_once[query.index[i]] = tally.dynamics[i] > 0 && !tally.in_turn[i];
      votes.porous[query.index[i]] = tally.porous[i];
      votes.first_occupied[query.index[i]] = tally.first[i];
      votes.last_occupied[query.index[i]] = tally.last[i];
    }
  };
  const bool with_ground = !key_frames.empty() && key_frames.front()->votes_on_ground();
  parallel_for(count, kVoteBlock, threads, [&](std::size_t begin, std::size_t end) {
    vote_on(select(points, ground, false, begin, end), false);
    if (with_ground) vote_on(select(points, ground, true, begin, end), true);
  });
  return votes;
}

}  // namespace docdepth
