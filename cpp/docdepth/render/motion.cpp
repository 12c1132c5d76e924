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
constexpr std::size_t kSome = 75;     ///< places tell whether it is where it must have been
constexpr float kSure = 0.3f;         ///< farther from where it must have been it is not found [m]
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

/// The objects of another sweep in the frame of this one.
std::vector<Places> brought(const Objects& other, const Pose& T_from_to) {
  std::vector<Places> result = other.places;
  const RigidTransform T(T_from_to);
  for (auto& places : result)
    for (auto& p : places) p = T * p;
  return result;
}

Extent extent(const Places& places) {
  Extent all{places[0], places[0]};
  for (const Vector& p : places) all.add({p, p});
  return all;
}

/// Not more than kSome of them.
Places some(const Places& places) {
  Places result;
  for (std::size_t i = 0; i < places.size(); i += 1 + (places.size() - 1) / kSome)
    result.push_back(places[i]);
  return result;
}

Vector middle(const Places& places) {
  Vector sum = Vector::Zero();
  for (const Vector& p : places) sum += p;
  return sum / float(places.size());
}

}  // namespace

std::vector<Box> Objects::boxes() const {
  std::vector<Box> boxes;
  for (const Places& object : places) {
    const Extent whole = extent(object);
    boxes.push_back({(whole.low + whole.high) / 2, whole.size() / 2});
  }
  return boxes;
}

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
                               int threads, const std::vector<std::uint8_t>& wanted) {
  const std::vector<Places> candidates = brought(other, passage.T_from_to);
  const float reach = passage.max_speed * std::fabs(passage.duration);
  const std::size_t count = objects.places.size();
  std::vector<Vector> result(count, Vector::Zero());
  if (!(reach > 0)) return result;
  std::vector<std::vector<Match>> matches(count, std::vector<Match>(candidates.size()));
  parallel_for(count, 1, threads, [&](std::size_t k, std::size_t) {
    const Places& places = objects.places[k];
    if (places.size() < kFewest || (!wanted.empty() && !wanted[k])) return;
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

std::vector<Again> find_again(const Objects& objects, const std::vector<Vector>& velocities,
                              const Objects& other, const Passage& passage) {
  const std::vector<Places> candidates = brought(other, passage.T_from_to);
  std::vector<Again> result;
  std::vector<Extent> extents;
  std::vector<Places> few;
  for (std::size_t k = 0; k < velocities.size(); ++k) {
    result.push_back({velocities[k] * passage.duration, {}});
    extents.push_back(extent(objects.places[k]));
    few.push_back(some(objects.places[k]));
  }
  for (std::size_t c = 0; c < candidates.size(); ++c) {
    const Extent there = extent(candidates[c]);
    const Places few_there = some(candidates[c]);
    float most = kExplained;
    std::size_t found = velocities.size();
    for (std::size_t k = 0; k < velocities.size(); ++k) {
      const Vector shift = velocities[k] * (passage.duration + other.late[c] - objects.late[k]);
      const Extent here{extents[k].low + shift, extents[k].high + shift};
      if (velocities[k].isZero(0) || !here.overlaps(there, 0)) continue;
      const float explained = share_found(few[k], shift, candidates[c]) *
                              share_found(few_there, -shift, objects.places[k]);
      if (explained > most) most = explained, found = k;
    }
    if (found < velocities.size()) result[found].objects.push_back(std::uint32_t(c));
  }
  for (std::size_t k = 0; k < velocities.size(); ++k) {
    Places there;
    for (const auto c : result[k].objects) {
      const float late = other.late[c] - objects.late[k];
      if (there.empty()) result[k].shift += velocities[k] * late;
      there.insert(there.end(), candidates[c].begin(), candidates[c].end());
    }
    Vector shift = result[k].shift;
    if (refine_shift(few[k], there, shift) && (shift - result[k].shift).norm() < kSure)
      result[k].shift = shift;
  }
  return result;
}

}  // namespace docdepth
