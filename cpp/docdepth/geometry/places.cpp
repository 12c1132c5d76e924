#include "docdepth/geometry/places.hpp"

#include <cmath>
#include <utility>

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

constexpr float kBin = 0.2f;         ///< of the counted differences
constexpr float kSameHeight = 0.2f;  ///< places farther apart in z are not the same

/// Numbers keys in the order in which they come; far faster here than the standard's map.
class Numbers {
 public:
  explicit Numbers(std::size_t most) {
    while (slots_.size() < 2 * most) slots_.resize(2 * slots_.size(), kEmpty);
    keys_.reserve(most);
  }
  std::size_t operator[](std::uint64_t key) {
    const std::size_t mask = slots_.size() - 1;
    std::size_t slot = (key * 0x9E3779B97F4A7C15u) >> 32 & mask;
    while (slots_[slot] != kEmpty && keys_[slots_[slot]] != key) slot = (slot + 1) & mask;
    if (slots_[slot] == kEmpty) {
      slots_[slot] = static_cast<std::uint32_t>(keys_.size());
      keys_.push_back(key);
    }
    return slots_[slot];
  }

 private:
  static constexpr std::uint32_t kEmpty = ~0u;
  std::vector<std::uint32_t> slots_ = std::vector<std::uint32_t>(8, kEmpty);
  std::vector<std::uint64_t> keys_;
};

/// Squared distance from p to the nearest of the places, and which.
std::pair<float, std::size_t> nearest(const Places& places, const Vector& p) {
  std::pair<float, std::size_t> found{INFINITY, 0};
  for (std::size_t i = 0; i < places.size(); ++i) {
    const float squared = (places[i] - p).squaredNorm();
    if (squared < found.first) found = {squared, i};
  }
  return found;
}

}  // namespace

Extent box_of(const Places& places) {
  Extent box{places.front(), places.front()};
  for (const Vector& p : places) box.add({p, p});
  return box;
}

std::uint64_t cube_key(std::int64_t x, std::int64_t y, std::int64_t z) {
  constexpr std::int64_t middle = 1 << 20, mask = (1 << 21) - 1;
  return std::uint64_t((x + middle) & mask) << 42 | std::uint64_t((y + middle) & mask) << 21 |
         std::uint64_t((z + middle) & mask);
}

std::int64_t cube_step(float value, float size) {
  const float steps = value / size;  // floor, without the call that old processors need
  const auto whole = static_cast<std::int64_t>(steps);
  return whole - (static_cast<float>(whole) > steps);
}

Places thinned(const Places& points, float size) {
  Numbers place_of(points.size());
  Places sums;
  std::vector<float> counts;
  for (const Vector& p : points) {
    const auto place =
        place_of[cube_key(cube_step(p.x(), size), cube_step(p.y(), size), cube_step(p.z(), size))];
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

Places thinned(const Places& points, float size, std::size_t most) {
  Places places = thinned(points, size);
  while (places.size() > most) places = thinned(points, size *= 1.3f);
  return places;
}

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

bool refine_shift(const Places& a, const Places& b, Vector& shift) {
  for (const float radius : {0.6f, 0.4f, 0.3f, 0.3f, 0.3f}) {
    Vector sum = Vector::Zero();
    std::size_t count = 0;
    for (const Vector& p : a) {
      const auto [squared, i] = nearest(b, p + shift);
      if (squared > radius * radius) continue;
      sum += b[i] - (p + shift);
      ++count;
    }
    if (!count) return false;
    shift += Vector(sum.x() / float(count), sum.y() / float(count), 0);
  }
  return true;
}

float share_found(const Places& places, const Vector& shift, const Places& in, float distance) {
  std::size_t found = 0;
  for (const Vector& p : places) found += nearest(in, p + shift).first < distance * distance;
  return float(found) / float(places.size());
}

}  // namespace docdepth
