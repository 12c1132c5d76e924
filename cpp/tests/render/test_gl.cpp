#include <doctest/doctest.h>

#include <cmath>
#include <random>
#include <thread>

#include "docdepth/render/gl/renderer.hpp"

/// OSMesa does not give back all of its own memory; the leak sanitizer asks for this by name.
extern "C" __attribute__((visibility("default"))) const char* __lsan_default_suppressions();
extern "C" const char* __lsan_default_suppressions() {
  return "leak:libOSMesa";
}

using namespace docdepth;
using gl::Backend;
using gl::GlError;
using gl::GlRenderer;

namespace {

constexpr Backend kBackends[] = {Backend::kEgl, Backend::kSurfaceless, Backend::kOsmesa};

/// Null where the back end is not available, which is said.
std::unique_ptr<GlRenderer> open(Backend backend) {
  try {
    return std::make_unique<GlRenderer>(gl::Choice{backend, -1, ""});
  } catch (const GlError& error) {
    MESSAGE("skipped: " << error.what());
    return nullptr;
  }
}

Cloud scattered(unsigned seed, int count) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> side(-20, 20), ahead(-5, 60);
  Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> points(count, 3);
  for (int i = 0; i < count; ++i) points.row(i) << side(random), side(random), ahead(random);
  return Cloud(points, std::vector<std::uint8_t>(count, 1));
}

PatchMesh scattered_mesh(unsigned seed, int count) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> side(-20, 20), ahead(-2, 60), step(-2, 2);
  std::vector<Eigen::Vector3f> vertices;
  std::vector<std::array<std::uint32_t, 3>> triangles;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3f p(side(random), side(random), ahead(random));
    const auto first = static_cast<std::uint32_t>(vertices.size());
    for (int k = 0; k < 3; ++k)
      vertices.push_back(p + Eigen::Vector3f(step(random), step(random), step(random)));
    triangles.push_back({first, first + 1, first + 2});
  }
  return PatchMesh(vertices, triangles);
}

Rays scattered_rays(unsigned seed, int count) {
  std::mt19937 random(seed);
  std::normal_distribution<float> place(0, 8);
  Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> points(count, 3);
  for (int i = 0; i < count; ++i)
    for (int k = 0; k < 3; ++k) points(i, k) = place(random);
  return Rays(points, std::vector<Eigen::Vector3f>(count, Eigen::Vector3f::Zero()));
}

std::size_t differences(const std::vector<float>& a, const std::vector<float>& b) {
  REQUIRE(a.size() == b.size());
  std::size_t count = 0;
  for (std::size_t i = 0; i < a.size(); ++i)
    count += !(a[i] == b[i] || (std::isnan(a[i]) && std::isnan(b[i])));
  return count;
}

}  // namespace

TEST_CASE("OpenGL draws the splats of the processor") {
  const Camera camera{90, 95, 80.3, 31.7, 160, 60};
  const SplatHeights heights({50, 3});
  const Cloud cloud = scattered(1, 5000), other = scattered(2, 3000);
  for (const Backend backend : kBackends) {
    const auto renderer = open(backend);
    if (!renderer) continue;
    for (const auto* drawn : {&cloud, &other, &cloud}) {
      Pose pose = Pose::Identity();
      pose.translation() << 0.3, -0.2, 1.7;
      const std::vector<PlacedCloud> placed{{drawn, pose, &heights}};
      const auto expected = render_splats(camera, placed, 1);
      const auto depth = renderer->render_splats(camera, placed);
      CHECK(differences(depth, expected) <=
            (renderer->context().software() ? 0 : depth.size() / 1000));
    }
  }
}

TEST_CASE("OpenGL draws the triangles of the processor, weighed alike") {
  const Camera camera{90, 95, 80.3, 31.7, 160, 60};
  const PatchMesh first = scattered_mesh(1, 60), second = scattered_mesh(2, 300),
                  third = scattered_mesh(3, 40);
  Pose pose = Pose::Identity();
  pose.translation() << 0.3, -0.2, 1.7;
  const Rays rays = scattered_rays(5, 20000);
  const PixelBounds all{0, 160, 0, 60};
  const std::vector<MeshScene> scenes{
      {{{&first, pose}}, {}, {}, {}},
      {{{&third, pose}}, {{&first, pose}, {&second, pose}, {&first, Pose::Identity()}}, {}, {}},
      {{},
       {{&second, pose}, {&first, pose}, {&third, pose}, {&first, pose}},
       {{&rays, pose}, {&rays, Pose::Identity()}},
       {{{{&third, pose}}, {}, {}, {}, all}}},
      {{{&first, pose}, {&third, pose}},
       {{&second, pose}},
       {{&rays, pose}},
       {{{{&second, pose}}, {{&third, pose}}, {{&first, pose}}, {{&rays, pose}}, all},
        {{{&third, pose}}, {}, {}, {}, all}}},
      MeshScene()};
  for (const Backend backend : kBackends) {
    const auto renderer = open(backend);
    if (!renderer) continue;
    for (const auto& scene : scenes) {
      const auto expected = render_triangles(camera, scene, 1);
      const auto depth = renderer->render_triangles(camera, scene);
      CHECK(differences(depth, expected) <=
            (renderer->context().software() ? 0 : depth.size() / 1000));
    }
  }
}

TEST_CASE("a context is for one thread") {
  const Camera camera{10, 10, 2, 2, 5, 5};
  for (const Backend backend : kBackends) {
    const auto renderer = open(backend);
    if (!renderer) continue;
    bool refused = false;
    std::thread([&] {
      try {
        renderer->render_splats(camera, {});
      } catch (const GlError&) {
        refused = true;
      }
    }).join();
    CHECK(refused);
    CHECK(std::isnan(renderer->render_splats(camera, {})[0]));
  }
}

TEST_CASE("missing libraries are errors that name them") {
  for (const Backend backend : kBackends)
    CHECK_THROWS_AS(GlRenderer(gl::Choice{backend, -1, "libnot_there.so"}), GlError);
  CHECK_THROWS_AS(gl::egl_devices("libnot_there.so"), GlError);
}
