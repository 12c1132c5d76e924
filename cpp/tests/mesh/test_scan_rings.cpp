#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <random>
#include <vector>

#include "docdepth/mesh/scan_rings.hpp"

using namespace docdepth;

namespace {

constexpr double kDegree = M_PI / 180;

struct Lidar {
  std::vector<double> elevations;  // of the lasers [degrees], as rows have them
  int columns;
  double stagger = 0;  // every second laser is turned so far [degrees]
  double shift = 0;    // the vehicle drives so far during the sweep [m]
};

Lidar even(double low, double high, int lasers, int columns) {
  Lidar lidar{{}, columns};
  for (int k = 0; k < lasers; ++k)
    lidar.elevations.push_back(low + (high - low) * k / (lasers - 1));
  return lidar;
}

/// A sweep of rows ring by ring, clockwise from behind: a tenth of the returns is missing.
struct Sweep {
  std::vector<Direction> directions;
  std::vector<int> lasers;

  void add(double azimuth, double elevation, double range, double forward, int laser) {
    directions.push_back(
        direction_of(static_cast<float>(range * std::cos(elevation) * std::cos(azimuth) + forward),
                     static_cast<float>(range * std::cos(elevation) * std::sin(azimuth)),
                     static_cast<float>(range * std::sin(elevation))));
    lasers.push_back(laser);
  }

  /// The same returns in another order.
  Sweep ordered(const std::vector<std::uint32_t>& order) const {
    Sweep other;
    for (const auto k : order) {
      other.directions.push_back(directions[k]);
      other.lasers.push_back(lasers[k]);
    }
    return other;
  }
};

Sweep sweep_of(const Lidar& lidar, std::mt19937& random) {
  Sweep sweep;
  for (std::size_t k = 0; k < lidar.elevations.size(); ++k)
    for (int c = 0; c < lidar.columns; ++c) {
      if (random() % 10 == 0) continue;
      const double share = (c + 0.5) / lidar.columns;
      const double azimuth = M_PI - 2 * M_PI * share + (k % 2 ? lidar.stagger * kDegree : 0);
      const double range = 12 + 6 * std::sin(5 * azimuth);
      sweep.add(azimuth, lidar.elevations[k] * kDegree, range, lidar.shift * (share - 0.5),
                static_cast<int>(k));
    }
  return sweep;
}

std::vector<std::uint32_t> rows_of(const Sweep& sweep) {
  std::vector<std::uint32_t> rows(sweep.directions.size());
  std::iota(rows.begin(), rows.end(), 0);
  return rows;
}

std::vector<std::uint32_t> shuffled(const Sweep& sweep, std::mt19937& random) {
  auto rows = rows_of(sweep);
  std::shuffle(rows.begin(), rows.end(), random);
  return rows;
}

/// Every return is in one ring, rings are in order of azimuth and of elevation, and the share of
/// returns that are in the ring most of its laser's returns are in, one ring for each laser.
double share_found(const Sweep& sweep) {
  const ScanRings rings = find_rings(sweep.directions, rows_of(sweep));
  auto sorted = rings.returns;
  std::sort(sorted.begin(), sorted.end());
  CHECK(sorted == rows_of(sweep));
  std::map<int, std::pair<int, std::size_t>> best;  // of a laser: most returns of a ring, the ring
  double last = -1e9;
  for (std::size_t r = 0; r < rings.count(); ++r) {
    std::map<int, int> lasers;
    double sum = 0;
    for (auto k = rings.begin[r]; k < rings.begin[r + 1]; ++k) {
      const auto row = rings.returns[k];
      ++lasers[sweep.lasers[row]];
      sum += sweep.directions[row].elevation;
    }
    CHECK(std::is_sorted(
        rings.returns.begin() + rings.begin[r], rings.returns.begin() + rings.begin[r + 1],
        [&](auto a, auto b) { return sweep.directions[a].azimuth < sweep.directions[b].azimuth; }));
    const double mean = sum / (rings.begin[r + 1] - rings.begin[r]);
    CHECK(mean >= last);
    last = mean;
    for (const auto& [laser, count] : lasers)
      best[laser] = std::max(best[laser], std::make_pair(count, r));
  }
  std::map<std::size_t, int> rings_used;
  int found = 0;
  for (const auto& [laser, most] : best) {
    found += most.first;
    CHECK(++rings_used[most.second] == 1);
  }
  return found / static_cast<double>(sweep.directions.size());
}

bool has_rings(const Sweep& sweep) {
  return find_rings(sweep.directions, rows_of(sweep)).count() > 0;
}

std::vector<Lidar> spinning() {
  Lidar two_blocks = even(2, -8.5, 32, 2000);  // HDL-64
  for (int k = 0; k < 32; ++k) two_blocks.elevations.push_back(-8.9 - 0.5 * k);
  two_blocks.stagger = 0.4;
  Lidar interleaved{{}, 1800};  // VLP-16: lasers do not fire from the bottom to the top
  for (int k = 0; k < 8; ++k)
    for (const double elevation : {-15.0 + 2 * k, 1.0 + 2 * k})
      interleaved.elevations.push_back(elevation);
  return {two_blocks, interleaved, even(15, -16, 32, 2000), even(22.5, -22.5, 128, 1024)};
}

}  // namespace

TEST_CASE("rings of spinning LiDARs are found ring by ring, column by column, and shuffled") {
  std::mt19937 random(3);
  for (const Lidar& lidar : spinning()) {
    const Sweep by_ring = sweep_of(lidar, random);
    CHECK(share_found(by_ring) > 0.998);
    auto by_time = rows_of(by_ring);
    std::stable_sort(by_time.begin(), by_time.end(), [&](std::uint32_t a, std::uint32_t b) {
      return by_ring.directions[a].azimuth / 40 > by_ring.directions[b].azimuth / 40;
    });
    CHECK(share_found(by_ring.ordered(by_time)) == 1);
    CHECK(share_found(by_ring.ordered(shuffled(by_ring, random))) == 1);
  }
}

TEST_CASE("rings that motion has bent are found ring by ring, and never guessed") {
  std::mt19937 random(4);
  for (Lidar lidar : spinning()) {
    lidar.shift = 2.5;
    const Sweep by_ring = sweep_of(lidar, random);
    CHECK(share_found(by_ring) > 0.998);
  }
  Lidar dense = even(2, -24, 64, 1800);
  dense.shift = 2.5;
  const Sweep bent = sweep_of(dense, random);
  CHECK(!has_rings(bent.ordered(shuffled(bent, random))));
}

TEST_CASE("rings of a narrow field of view are found") {
  std::mt19937 random(5);
  const Sweep whole = sweep_of(even(2, -24, 64, 2000), random);
  std::vector<std::uint32_t> ahead;
  for (const auto row : rows_of(whole))
    if (std::abs(whole.directions[row].azimuth) < kTurn / 8) ahead.push_back(row);
  CHECK(share_found(whole.ordered(ahead)) == 1);
}

TEST_CASE("rosettes, several LiDARs in one sweep, and few returns have no rings") {
  std::mt19937 random(6);
  Sweep rosette;
  for (int k = 0; k < 24000; ++k) {
    const double time = 0.1 * k / 24000, a = 2 * M_PI * 121.6 * time, b = -2 * M_PI * 77.7 * time;
    rosette.add(35 * kDegree * (std::cos(a) + std::cos(b)) / 2,
                38 * kDegree * (std::sin(a) + std::sin(b)) / 2, 20, 0, 0);
  }
  CHECK(!has_rings(rosette));
  CHECK(!has_rings(rosette.ordered(shuffled(rosette, random))));

  // Two LiDARs at two corners of a roof, tilted.
  Sweep both;
  for (const double side : {-1.0, 1.0}) {
    const Sweep one = sweep_of(even(15, -15, 16, 1800), random);
    for (std::size_t k = 0; k < one.directions.size(); ++k) {
      const double azimuth = one.directions[k].azimuth * double{kRadiansPerUnit};
      const double tilt = side * 12 * kDegree * std::sin(azimuth);
      both.add(azimuth, one.directions[k].elevation * double{kRadiansPerUnit} + tilt, 10, side,
               one.lasers[k]);
    }
  }
  CHECK(!has_rings(both.ordered(shuffled(both, random))));
  CHECK(!has_rings({}));
  CHECK(!has_rings(sweep_of(even(10, -10, 8, 20), random)));
}
