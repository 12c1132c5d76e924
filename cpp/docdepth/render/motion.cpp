#include "docdepth/render/motion.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/places.hpp"
#include "docdepth/geometry/rigid.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

constexpr float kSide = 0.5f;         ///< returns in cells of this size side by side are one object
constexpr float kThin = 0.15f;        ///< edge of the cubes of which each gives one place
constexpr std::size_t kPlaces = 300;  ///< of larger objects the cubes are larger
constexpr std::size_t kFewest = 5;    ///< with fewer places an object has no shape to be found by
constexpr float kExplained = 0.4f;    ///< share of places found again, of one times the other

struct Match {
  Vector shift = Vector::Zero();
  float explained = 0;
};

Match match(const Places& a, const Places& b, float reach) {
  Match match{most_frequent_shift(a, b, reach), 0};
  if (!refine_shift(a, b, match.shift)) return {};
  match.explained = share_found(a, match.shift, b) * share_found(b, -match.shift, a);
  return match;
}

Vector middle(const Places& places) {
  Vector sum = Vector::Zero();
  for (const Vector& p : places) sum += p;
  return sum / float(places.size());
}

}  // namespace

Objects find_objects(const Points& points, const std::uint16_t* classid, const float* late) {
  Objects objects;
  objects.owner.assign(points.rows(), 0);
  std::unordered_map<std::uint64_t, std::vector<std::uint32_t>> cells;
  const auto cell = [&](std::uint32_t i) {
    return std::pair(cube_step(points(i, 0), kSide), cube_step(points(i, 1), kSide));
  };
  for (std::uint32_t i = 0; i < points.rows(); ++i) {
    if (classid[i] < kDynamic) continue;
    const auto [x, y] = cell(i);
    cells[cube_key(x, y)].push_back(i);
  }
  for (std::uint32_t first = 0; first < points.rows(); ++first) {
    if (classid[first] < kDynamic || objects.owner[first]) continue;
    const auto number = static_cast<std::uint32_t>(objects.places.size() + 1);
    std::vector<std::uint32_t> members{first};
    objects.owner[first] = number;
    for (std::size_t done = 0; done < members.size(); ++done) {
      const auto [x, y] = cell(members[done]);
      for (int dx = -1; dx <= 1; ++dx)
        for (int dy = -1; dy <= 1; ++dy) {
          const auto near = cells.find(cube_key(x + dx, y + dy));
          if (near == cells.end()) continue;
          for (const auto i : near->second) {
            objects.owner[i] = number;
            members.push_back(i);
          }
          cells.erase(near);
        }
    }
    Places all;
    double sum = 0;
    for (std::size_t i = 1; i < members.size(); ++i) {  // the first is met again in its cell
      all.push_back(points.row(members[i]));
      if (late) sum += late[members[i]];
    }
    objects.late.push_back(static_cast<float>(sum / double(all.size())));
    objects.places.push_back(thinned(all, kThin, kPlaces));
  }
  return objects;
}

std::vector<Vector> velocities(const Objects& objects, const Objects& other, const Passage& passage,
                               int threads) {
  std::vector<Places> candidates = other.places;
  const RigidTransform T(passage.T_from_to);
  for (auto& places : candidates)
    for (auto& p : places) p = T * p;
  const float reach = passage.max_speed * std::fabs(passage.duration);
  std::vector<Vector> result(objects.places.size(), Vector::Zero());
  if (!(reach > 0)) return result;
  parallel_for(result.size(), 1, threads, [&](std::size_t k, std::size_t) {
    const Places& places = objects.places[k];
    if (places.size() < kFewest) return;
    const Vector here = middle(places);
    float best = 0;
    for (std::size_t c = 0; c < candidates.size(); ++c) {
      if ((middle(candidates[c]) - here).norm() > reach) continue;
      const Match found = match(places, candidates[c], reach);
      // Of two that fit alike the nearer is the likelier.
      const float score = found.explained * std::exp(-found.shift.norm() / (2 * reach));
      if (found.explained < kExplained || score <= best) continue;
      best = score;
      // Times within the sweeps change the duration a little, or they are wrong.
      const float between = passage.duration + other.late[c] - objects.late[k];
      result[k] = found.shift / (between / passage.duration > 0.5f ? between : passage.duration);
    }
  });
  return result;
}

}  // namespace docdepth
