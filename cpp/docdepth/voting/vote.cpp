#include <algorithm>
#include <cstddef>
#include <limits>
#include <optional>
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

/// Chosen rows [begin, end) of a sweep as columns.
BlockPoints columns_of(const Points& points, const std::vector<std::size_t>& rows,
                       std::size_t begin, std::size_t end) {
  BlockPoints columns;
  columns.index.assign(rows.begin() + begin, rows.begin() + end);
  for (const std::size_t i : columns.index) {
    columns.x.push_back(points(i, 0));
    columns.y.push_back(points(i, 1));
    columns.z.push_back(points(i, 2));
  }
  return columns;
}

/// The usable points that are ground, or that are not.
std::vector<std::size_t> rows_of(const Points& points, const bool* ground, bool of_ground) {
  std::vector<std::size_t> rows;
  for (Eigen::Index i = 0; i < points.rows(); ++i)
    if (ground[i] == of_ground && usable(range_of(points(i, 0), points(i, 1), points(i, 2))))
      rows.push_back(std::size_t(i));
  return rows;
}

/// A batch of points in the frame of a key frame.
class Batch {
 public:
  /// Move the points from `begin` on to the key frame and find their pixels there.
  void find(const BlockPoints& query, std::size_t begin, const KeyFrame& key_frame,
            const RigidTransform& T_key_query, bool ground) {
    key_frame_ = &key_frame;
    ground_ = ground;
    size_ = std::min(QueryPoints::kMax, query.size() - begin);
    dispatch<MovePoints>(size_, &query.x[begin], &query.y[begin], &query.z[begin], T_key_query, x_,
                         y_, z_, range_);
    key_frame.find(points(), pixels_);
  }
  void vote(std::uint16_t* statics, std::uint16_t* dynamics) const {
    key_frame_->vote(points(), pixels_, statics, dynamics);
  }

 private:
  QueryPoints points() const { return {size_, x_, y_, z_, range_, ground_}; }

  const KeyFrame* key_frame_;
  std::size_t size_;
  bool ground_;
  float x_[QueryPoints::kMax], y_[QueryPoints::kMax], z_[QueryPoints::kMax],
      range_[QueryPoints::kMax];
  std::int32_t pixels_[QueryPoints::kMax];
};

/// Few road users are where another one was so soon before [s]: people who walk in single file.
constexpr double kMinHeadway = 1;

/// As wide as the other values of a point, so that many points are looked at at once.
using Flag = std::uint16_t;
constexpr Flag kTrue = 0xffff;
DOCDEPTH_KERNEL Flag flag(bool value) {
  return value ? kTrue : 0;
}
DOCDEPTH_KERNEL std::uint16_t chosen(Flag flag, std::uint16_t yes, std::uint16_t no) {
  return (flag & yes) | (~flag & no);
}

/// The votes on a batch of points so far, and what they say in order of time.
struct Tally {
  static constexpr std::size_t kMax = QueryPoints::kMax;

  std::uint16_t statics[kMax] = {}, dynamics[kMax] = {};
  std::uint16_t seen_statics[kMax] = {}, seen_dynamics[kMax] = {};
  std::uint16_t first[kMax], last[kMax];
  std::uint16_t turn[kMax] = {};                      ///< of what found it occupied last
  Flag was_occupied[kMax] = {}, was_left[kMax] = {};  ///< was_left: free since it was occupied
  Flag in_turn[kMax] = {}, porous[kMax] = {};

  Tally() {
    std::fill_n(first, kMax, Votes::kNever);
    std::fill_n(last, kMax, Votes::kNever);
  }

  /// The sweep itself found all its points occupied.
  /// @param now     its turn
  /// @param recent  the first turn within kMinHeadway before it
  void note_sweep(std::uint16_t now, std::uint16_t recent) {
    for (std::size_t i = 0; i < kMax; ++i) {
      in_turn[i] |= was_left[i];
      porous[i] |= was_left[i] & flag(turn[i] >= recent);
      was_occupied[i] = kTrue;
      was_left[i] = 0;
      turn[i] = now;
    }
  }
};

/// Take note of the votes of a key frame.
struct NoteVotes {
  DOCDEPTH_KERNEL static void run(std::uint16_t key_frame, std::uint16_t now, std::uint16_t recent,
                                  Tally& of) {
    for (std::size_t i = 0; i < Tally::kMax; ++i) {
      const Flag occupied = flag(of.statics[i] != of.seen_statics[i]);
      const Flag free = flag(of.dynamics[i] != of.seen_dynamics[i]);
      const Flag again = occupied & of.was_left[i];
      of.seen_statics[i] = of.statics[i];
      of.seen_dynamics[i] = of.dynamics[i];
      of.in_turn[i] |= again;
      of.porous[i] |= again & flag(of.turn[i] >= recent);
      const Flag is_first = occupied & flag(of.first[i] == Votes::kNever);
      of.first[i] = chosen(is_first, key_frame, of.first[i]);
      of.last[i] = chosen(occupied, key_frame, of.last[i]);
      of.turn[i] = chosen(occupied, now, of.turn[i]);
      of.was_occupied[i] |= occupied;
      of.was_left[i] = (of.was_left[i] & ~occupied) | (free & of.was_occupied[i]);
    }
  }
};

/// Key frames with their poses, as they vote on one sweep.
class Voters {
 public:
  Voters(const std::vector<const KeyFrame*>& key_frames, const std::vector<Pose>& T_world_key,
         const Pose& T_world_lidar, const std::vector<double>& seconds)
      : key_frames_(key_frames), seconds_(seconds) {
    for (const Pose& pose : T_world_key) T_key_query_.emplace_back(between(pose, T_world_lidar));
    for (std::size_t k = 0; k < seconds.size(); ++k)
      sweep_.push_back(k == 0 ? 0 : sweep_.back() + (seconds[k] != seconds[k - 1]));
  }

  /// Numbers of those of every `step`-th sweep: of several LiDARs that measure at once, all.
  std::vector<std::size_t> every(std::size_t step) const {
    std::vector<std::size_t> chosen;
    for (std::size_t k = 0; k < sweep_.size(); ++k)
      if (sweep_[k] % step == step / 2) chosen.push_back(k);
    return chosen;
  }
  std::size_t sweeps() const { return sweep_.empty() ? 0 : sweep_.back() + 1; }

  /// The votes of chosen ones on some rows; each counts as `weight` votes.
  void vote(const Points& points, const std::vector<std::size_t>& rows, bool of_ground,
            const std::vector<std::size_t>& chosen, int weight, int threads, Votes& votes) const {
    parallel_for(rows.size(), kVoteBlock, threads, [&](std::size_t begin, std::size_t end) {
      const BlockPoints query = columns_of(points, rows, begin, end);
      const std::vector<Tally> tallies = tally_of(query, of_ground, chosen);
      for (std::size_t k = 0; k < query.size(); ++k) {
        const Tally& tally = tallies[k / Tally::kMax];
        const std::size_t row = query.index[k], i = k % Tally::kMax;
        votes.statics[row] = static_cast<std::uint16_t>(weight * tally.statics[i]);
        votes.dynamics[row] = static_cast<std::uint16_t>(weight * tally.dynamics[i]);
        votes.occupied_once[row] = tally.dynamics[i] > 0 && !tally.in_turn[i];
        votes.porous[row] = tally.porous[i] != 0;
        votes.first_occupied[row] = tally.first[i];
        votes.last_occupied[row] = tally.last[i];
      }
    });
  }

 private:
  std::vector<Tally> tally_of(const BlockPoints& query, bool of_ground,
                              const std::vector<std::size_t>& chosen) const {
    const std::size_t count = (query.size() + QueryPoints::kMax - 1) / QueryPoints::kMax;
    std::vector<Tally> tallies(count);
    const auto is_earlier = [&](std::size_t k) { return seconds_[k] < 0; };
    const auto earlier = std::size_t(std::count_if(chosen.begin(), chosen.end(), is_earlier));
    // What looks in turn: key frames [s after the sweep], and the sweep itself among them.
    std::vector<float> seconds;
    for (const std::size_t k : chosen) seconds.push_back(float(seconds_[k]));
    seconds.insert(seconds.begin() + std::ptrdiff_t(earlier), 0.0f);
    std::vector<std::uint16_t> recent;  // the first turn within kMinHeadway before each
    for (auto now = seconds.begin(); now != seconds.end(); ++now) {
      const auto is_near = [&](float time) { return *now - time <= float(kMinHeadway); };
      const auto near = std::find_if(seconds.begin(), now + 1, is_near);  // without times none
      recent.push_back(static_cast<std::uint16_t>(near - seconds.begin()));
    }
    const auto note_sweep = [&](Tally& tally) {
      tally.note_sweep(std::uint16_t(earlier), recent[earlier]);
    };
    Batch batches[2];
    for (std::size_t n = 0; n <= count * chosen.size(); ++n) {
      Batch& next = batches[n % 2];
      const Batch& last = batches[1 - n % 2];
      if (n < count * chosen.size()) {
        const std::size_t k = chosen[n / count];
        next.find(query, n % count * QueryPoints::kMax, *key_frames_[k], T_key_query_[k],
                  of_ground);
      }
      if (n == 0) continue;
      Tally& tally = tallies[(n - 1) % count];
      last.vote(tally.statics, tally.dynamics);
      const std::size_t of = (n - 1) / count, turn = of + (of >= earlier);
      if (of == earlier) note_sweep(tally);
      dispatch<NoteVotes>(std::uint16_t(chosen[of]), std::uint16_t(turn), recent[turn], tally);
    }
    if (earlier >= chosen.size())
      for (Tally& tally : tallies) note_sweep(tally);
    return tallies;
  }

  const std::vector<const KeyFrame*>& key_frames_;
  const std::vector<double>& seconds_;
  std::vector<std::size_t> sweep_;  // key frames of one time are of one sweep
  std::vector<RigidTransform> T_key_query_;
};

/// Of the first votes: one of so many points,
constexpr std::size_t kPointStep = 4;
/// and key frames of one of so many sweeps,
constexpr int kSweepStep = 3;
/// if there are at least so many. Fewer see too little of what passes.
constexpr std::size_t kMinSweeps = 24;
/// A place was clearly free if its static votes are fewer than so many times its dynamic ones: it
/// is ground with as many, and twice that is a margin for the few that voted. Above level ground
/// voting is so exact that half of it was seen through at some time.
constexpr int kClearlyFreeRatio = 2;
/// Directions are told apart in pixels of this size [rad]: one degree.
constexpr double kPixel = 0.01745329251994330;
/// Where fewer of the first lie in a pixel and the eight around it, all key frames vote, too: by
/// sixteen beams, those may all miss somebody who walks. By 64 they are thirty.
constexpr int kMinSamples = 12;

/// The directions of a sweep in pixels, and in which of them anything was found free.
class FreeDirections {
 public:
  explicit FreeDirections(const Points& points)
      : columns_(grid_.columns()),
        pixel_(points.rows()),
        free_(std::size_t(grid_.rows()) * columns_),
        clearly_free_(free_.size()),
        samples_(free_.size()) {
    const Returns returns(points);
    std::vector<std::int32_t> row(returns.size()), column(returns.size());
    grid_.pixels(returns.size(), returns.x.data(), returns.y.data(), returns.z.data(),
                 returns.range.data(), row.data(), column.data());
    for (std::size_t i = 0; i < returns.size(); ++i)
      pixel_[returns.number[i]] = row[i] * columns_ + column[i];
  }

  /// Count the points that get the first votes.
  /// @return whether there are enough of them in most of their directions
  bool count(const std::vector<std::size_t>& some) {
    std::fill(samples_.begin(), samples_.end(), 0);
    for (const std::size_t row : some) each_near(row, [&](int pixel) { ++samples_[pixel]; });
    const auto is_known = [&](std::size_t row) { return samples_[pixel_[row]] >= kMinSamples; };
    return 2 * std::size_t(std::count_if(some.begin(), some.end(), is_known)) > some.size();
  }

  /// Take note of the first votes. All key frames vote on what lies in a pixel where something was
  /// found free and in the eight around it. On ground they do if the place was clearly free,
  /// whatever it was: the feet of what moves may be labelled ground.
  void add(const std::vector<std::size_t>& some, const Votes& votes) {
    for (const std::size_t row : some) {
      const int statics = votes.statics[row], dynamics = votes.dynamics[row];
      if (!dynamics) continue;
      const bool is_clear = kClearlyFreeRatio * dynamics > statics;
      each_near(row, [&](int pixel) { (is_clear ? clearly_free_ : free_)[pixel] = 1; });
    }
  }

  /// Give each point in whose direction enough was asked and nothing found free the votes on the
  /// last point of `some` before it that lies in its pixel, or else on the first one.
  /// @return the other points
  std::vector<std::size_t> spread(const std::vector<std::size_t>& rows,
                                  const std::vector<std::size_t>& some, bool of_ground,
                                  Votes& votes) const {
    constexpr auto none = std::numeric_limits<std::size_t>::max();
    std::vector<std::size_t> latest(free_.size(), none), left;
    for (auto i = some.rbegin(); i != some.rend(); ++i) latest[pixel_[*i]] = *i;
    auto next = some.begin();
    for (const std::size_t row : rows) {
      const std::int32_t pixel = pixel_[row];
      std::size_t& from = latest[pixel];
      if (next != some.end() && *next == row) from = *next++;
      const bool is_free = clearly_free_[pixel] || (!of_ground && free_[pixel]);
      if (from == none || samples_[pixel] < kMinSamples || is_free) {
        left.push_back(row);
        continue;
      }
      votes.statics[row] = votes.statics[from];
      votes.dynamics[row] = votes.dynamics[from];
      votes.occupied_once[row] = votes.occupied_once[from];
      votes.porous[row] = votes.porous[from];
      votes.first_occupied[row] = votes.first_occupied[from];
      votes.last_occupied[row] = votes.last_occupied[from];
    }
    return left;
  }

 private:
  /// Call `use` with the pixel of a point and those around it.
  template <class Use>
  void each_near(std::size_t row, const Use& use) const {
    const int v = pixel_[row] / columns_, u = pixel_[row] % columns_;
    for (int dv = -1; dv <= 1; ++dv)
      for (int du = -1; du <= 1; ++du)
        if (v + dv >= 0 && v + dv < grid_.rows())
          use((v + dv) * columns_ + (u + du + columns_) % columns_);
  }

  SphericalGrid grid_{kPixel};
  int columns_;
  std::vector<std::int32_t> pixel_;
  std::vector<std::uint8_t> free_, clearly_free_;
  std::vector<int> samples_;  // in the nine pixels around each
};

}  // namespace

Votes vote(const Points& points, const bool* ground, const Pose& T_world_lidar,
           const std::vector<const KeyFrame*>& key_frames, const std::vector<Pose>& T_world_key,
           const std::vector<double>& seconds, int threads, bool coarse_first) {
  if (key_frames.size() != T_world_key.size() || key_frames.size() != seconds.size())
    throw std::invalid_argument("vote needs one pose and one time for each key frame");
  const auto count = static_cast<std::size_t>(points.rows());
  Votes votes{std::vector<std::uint16_t>(count),
              std::vector<std::uint16_t>(count),
              std::vector<std::uint8_t>(count),
              std::vector<std::uint8_t>(count),
              std::vector<std::uint16_t>(count, Votes::kNever),
              std::vector<std::uint16_t>(count, Votes::kNever)};
  const Voters voters(key_frames, T_world_key, T_world_lidar, seconds);
  const bool with_ground = !key_frames.empty() && key_frames.front()->votes_on_ground();
  std::optional<FreeDirections> directions;
  if (coarse_first && voters.sweeps() >= kMinSweeps) directions.emplace(points);
  for (const bool of_ground : {false, true}) {
    if (of_ground && !with_ground) break;
    std::vector<std::size_t> rows = rows_of(points, ground, of_ground);
    if (directions) {
      std::vector<std::size_t> some;
      for (std::size_t k = kPointStep / 2; k < rows.size(); k += kPointStep)
        some.push_back(rows[k]);
      if (directions->count(some)) {
        voters.vote(points, some, of_ground, voters.every(kSweepStep), kSweepStep, threads, votes);
        directions->add(some, votes);
        rows = directions->spread(rows, some, of_ground, votes);
      }
    }
    voters.vote(points, rows, of_ground, voters.every(1), 1, threads, votes);
  }
  return votes;
}

}  // namespace docdepth
