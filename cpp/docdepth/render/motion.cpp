#include "docdepth/render/motion.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/rigid.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Places = std::vector<Vector>;

constexpr float kSide = 0.5f;         ///< returns in cells of this size side by side are one object
constexpr float kThin = 0.15f;        ///< edge of the cubes of which each gives one place
constexpr std::size_t kPlaces = 300;  ///< of larger objects the cubes are larger
constexpr float kBin = 0.2f;          ///< of the counted differences
constexpr float kSameHeight = 0.2f;   ///< places farther apart in z are not the same
constexpr float kFound = 0.3f;        ///< a place is found again when another is this near
constexpr std::size_t kFewest = 5;    ///< with fewer places an object has no shape to be found by
constexpr float kExplained = 0.4f;    ///< share of places found again, of one times the other

std::uint64_t cell_of(std::int64_t x, std::int64_t y, std::int64_t z = 0) {
  constexpr std::int64_t middle = 1 << 20, mask = (1 << 21) - 1;
  return std::uint64_t((x + middle) & mask) << 42 | std::uint64_t((y + middle) & mask) << 21 |
         std::uint64_t((z + middle) & mask);
}

std::int64_t step(float value, float size) {
  return static_cast<std::int64_t>(std::floor(value / size));
}

/// The mean of the points in each cube.
Places thinned(const Places& points, float size) {
  std::unordered_map<std::uint64_t, std::size_t> place_of;
  Places sums;
  std::vector<float> counts;
  for (const Vector& p : points) {
    const auto cell = cell_of(step(p.x(), size), step(p.y(), size), step(p.z(), size));
    const auto place = place_of.emplace(cell, sums.size()).first->second;
    if (place == sums.size()) {
      sums.push_back(Vector::Zero());
      counts.push_back(0);
    }
    sums[place] += p;
    ++counts[place];
  }
  for (std::size_t i = 0; i < sums.size(); ++i) sums[i] /= counts[i];
  return sums;
}

/// The horizontal shift that explains most differences b - a.
Vector most_frequent_shift(const Places& a, const Places& b, float reach) {
  const int side = 2 * static_cast<int>(std::ceil(reach / kBin)) + 3;  // a border of empty bins
  std::vector<int> counts(side * side, 0);
  for (const Vector& p : a)
    for (const Vector& q : b) {
      const Vector d = q - p;
      if (std::fabs(d.z()) > kSameHeight || std::fabs(d.x()) > reach || std::fabs(d.y()) > reach)
        continue;
      const int u = side / 2 + static_cast<int>(std::lround(d.x() / kBin));
      const int v = side / 2 + static_cast<int>(std::lround(d.y() / kBin));
      ++counts[u * side + v];
    }
  int most = -1, best = 0;
  for (int u = 1; u + 1 < side; ++u)
    for (int v = 1; v + 1 < side; ++v) {
      int sum = 0;
      for (int du = -1; du <= 1; ++du)
        for (int dv = -1; dv <= 1; ++dv) sum += counts[(u + du) * side + v + dv];
      if (sum > most) most = sum, best = u * side + v;
    }
  return {float(best / side - side / 2) * kBin, float(best % side - side / 2) * kBin, 0};
}

/// Squared distance from p to the nearest of the places, and which.
std::pair<float, std::size_t> nearest(const Places& places, const Vector& p) {
  std::pair<float, std::size_t> found{INFINITY, 0};
  for (std::size_t i = 0; i < places.size(); ++i) {
    const float squared = (places[i] - p).squaredNorm();
    if (squared < found.first) found = {squared, i};
  }
  return found;
}

float share_found(const Places& places, const Vector& shift, const Places& in) {
  std::size_t found = 0;
  for (const Vector& p : places) found += nearest(in, p + shift).first < kFound * kFound;
  return float(found) / float(places.size());
}

struct Match {
  Vector shift = Vector::Zero();
  float explained = 0;
};

Match match(const Places& a, const Places& b, float reach) {
  Match match{most_frequent_shift(a, b, reach), 0};
  for (const float radius : {0.6f, 0.4f, 0.3f, 0.3f, 0.3f}) {
    Vector sum = Vector::Zero();
    std::size_t count = 0;
    for (const Vector& p : a) {
      const auto [squared, i] = nearest(b, p + match.shift);
      if (squared > radius * radius) continue;
      sum += b[i] - (p + match.shift);
      ++count;
    }
    if (!count) return {};
    match.shift += Vector(sum.x() / float(count), sum.y() / float(count), 0);
  }
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
    return std::pair(step(points(i, 0), kSide), step(points(i, 1), kSide));
  };
  for (std::uint32_t i = 0; i < points.rows(); ++i) {
    if (classid[i] < kDynamic) continue;
    const auto [x, y] = cell(i);
    cells[cell_of(x, y)].push_back(i);
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
          const auto near = cells.find(cell_of(x + dx, y + dy));
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
    float size = kThin;
    Places places = thinned(all, size);
    while (places.size() > kPlaces) places = thinned(all, size *= 1.3f);
    objects.places.push_back(std::move(places));
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
