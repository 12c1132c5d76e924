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
constexpr float kTaken = 0.5f;        ///< share of places where another one is already

/// How an object comes to lie on another; with a score of 0 it does not.
struct Match {
  Vector shift = Vector::Zero();
  float score = 0;
};

Match match(const Places& a, const Places& b, float reach) {
  Vector shift = most_frequent_shift(a, b, reach);
  if (!refine_shift(a, b, shift)) return {};
  const float explained = share_found(a, shift, b) * share_found(b, -shift, a);
  if (explained < kExplained) return {};
  // Of two that fit alike the nearer is the likelier.
  return {shift, explained * std::exp(-shift.norm() / (2 * reach))};
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
  const std::size_t count = objects.places.size();
  std::vector<Vector> result(count, Vector::Zero());
  if (!(reach > 0)) return result;
  std::vector<std::vector<Match>> matches(count, std::vector<Match>(candidates.size()));
  parallel_for(count, 1, threads, [&](std::size_t k, std::size_t) {
    const Places& places = objects.places[k];
    if (places.size() < kFewest) return;
    const Vector here = middle(places);
    for (std::size_t c = 0; c < candidates.size(); ++c)
      if ((middle(candidates[c]) - here).norm() <= reach)
        matches[k][c] = match(places, candidates[c], reach);
  });
  const auto worse = [](const Match& a, const Match& b) { return a.score < b.score; };
  std::vector<std::size_t> best(candidates.size(), 0);  // of the objects, for each candidate
  for (std::size_t c = 0; c < candidates.size(); ++c)
    for (std::size_t k = 1; k < count; ++k)
      if (worse(matches[best[c]][c], matches[k][c])) best[c] = k;
  for (std::size_t k = 0; k < count; ++k) {
    auto own = matches[k];
    for (std::size_t c = 0; c < candidates.size(); ++c) {
      const Vector apart = own[c].shift - matches[best[c]][c].shift;
      if (own[c].score > 0 && best[c] != k &&
          share_found(objects.places[k], apart, objects.places[best[c]]) > kTaken)
        own[c].score = 0;
    }
    const auto found = std::max_element(own.begin(), own.end(), worse);
    if (found == own.end() || !(found->score > 0)) continue;
    // Times within the sweeps change the duration a little, or they are wrong.
    const float late = other.late[found - own.begin()] - objects.late[k];
    const float between = passage.duration + late;
    result[k] = found->shift / (between / passage.duration > 0.5f ? between : passage.duration);
  }
  return result;
}

}  // namespace docdepth
