#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "docdepth/render/straight_outlines.hpp"

using namespace docdepth;

namespace {

constexpr int kWidth = 60, kHeight = 50, kEdge = 30;
constexpr float kSpacing = 3.6f;  // a window of 8 rows to each side, 2 pixels to the left and right
constexpr float kThing = 10, kWall = 30, kNone = std::numeric_limits<float>::quiet_NaN();
constexpr Camera kView{700, 700, 30, 25, kWidth, kHeight};

/// A near thing to the left of `edge(row)`, before a wall.
template <class Edge>
std::vector<float> scene(const Edge& edge) {
  std::vector<float> depth;
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u) depth.push_back(u < edge(v) ? kThing : kWall);
  return depth;
}

std::vector<float> straightened(std::vector<float> depth) {
  std::vector<std::uint16_t> shown;
  straighten_outlines(kView, kSpacing, depth, shown, 1);
  return depth;
}

/// As rings of a LiDAR see a straight outline: five rows each, up to a pixel beside it.
int jagged(int v) {
  constexpr int kJags[] = {1, -1, 0};
  return kEdge + kJags[v / 5 % 3];
}

/// Mean distance in pixels from the outline, away from the ends of the image.
double error(const std::vector<float>& depth) {
  double sum = 0;
  for (int v = 9; v < kHeight - 9; ++v) {
    int width = 0;
    for (int u = 0; u < kWidth; ++u) width += depth[v * kWidth + u] == kThing;
    sum += std::abs(width - kEdge);
  }
  return sum / (kHeight - 18);
}

}  // namespace

TEST_CASE("the outline between rings becomes straight") {
  const std::vector<float> depth = scene(jagged);
  CHECK(error(depth) > 0.6);
  CHECK(error(straightened(depth)) < 0.3);
  for (const int lean : {-3, 3}) {  // pixels to the side in ten rows
    const auto leaning = scene([&](int v) { return kEdge + lean * (v - 25) / 10; });
    const auto result = straightened(leaning);
    int changed = 0;
    for (std::size_t i = 0; i < result.size(); ++i) changed += result[i] != leaning[i];
    CHECK(changed < kHeight / 4);
  }
}

TEST_CASE("what is straight, thin, or of one surface stays") {
  const auto stays = [](const std::vector<float>& depth) { return straightened(depth) == depth; };
  CHECK(stays(scene([](int) { return kEdge; })));
  auto post = scene([](int) { return 0; });
  for (int v = 0; v < kHeight; ++v) post[v * kWidth + kEdge] = kThing;
  CHECK(stays(post));
  CHECK(stays(scene([](int v) { return v < 25 ? kEdge : kEdge + 12; })));  // a corner
  std::vector<float> slope;  // 5 % from pixel to pixel
  for (int i = 0; i < kWidth * kHeight; ++i) slope.push_back(std::pow(1.05f, float(i % kWidth)));
  CHECK(stays(slope));
}

TEST_CASE("pixels without depth stay empty, and an outline ends where neither side goes on") {
  auto depth = scene(jagged);
  for (int v = 0; v < kHeight; ++v) depth[v * kWidth + kEdge] = kNone;
  const auto result = straightened(depth);
  for (int v = 0; v < kHeight; ++v) CHECK(std::isnan(result[v * kWidth + kEdge]));
  auto alone = scene(jagged);  // between things of other depths
  for (int i = 0; i < kWidth * kHeight; ++i)
    if (std::abs(i / kWidth - 25) > 5) alone[i] = 14.0f;
  CHECK(straightened(alone) == alone);
}

TEST_CASE("a pixel shows the object of the surface that it takes") {
  auto depth = scene(jagged);
  std::vector<std::uint16_t> shown;
  for (const float d : depth) shown.push_back(d == kThing ? 7 : 0);
  auto fewer = depth;
  auto shown_by_fewer = shown;
  straighten_outlines(kView, kSpacing, depth, shown, 1);
  for (std::size_t i = 0; i < depth.size(); ++i) CHECK(shown[i] == (depth[i] == kThing ? 7 : 0));
  straighten_outlines(kView, kSpacing, fewer, shown_by_fewer, 3);
  CHECK(depth == fewer);  // whatever the number of threads
}
