#include "docdepth/render/splats.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <memory>
#include <mutex>
#include <new>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/rigid.hpp"
#include "docdepth/geometry/simd.hpp"

// The size of a splat depends only on its distance. So all points with one height are first drawn
// as single pixels into an image of that height. Spreading the discs is then a grey-scale dilation,
// the maximum of shifted rows, which all points share.
namespace docdepth {
namespace {

// Depth as an integer that is 0 for an empty pixel and grows as depth falls: bits of positive
// floats are ordered like the floats. Fresh pages of zeros are an empty image for free.
constexpr std::int32_t kNearest = 0x7f800000;
DOCDEPTH_KERNEL std::int32_t inverted_bits(std::uint32_t depth_bits) {
  return kNearest - static_cast<std::int32_t>(depth_bits);
}

constexpr int kTile = 64;  // pixels of a row that are skipped together when they are empty

struct Zeros {
  void operator()(void* memory) const { std::free(memory); }
  template <class T>
  static std::unique_ptr<T[], Zeros> make(std::size_t count) {
    void* memory = std::calloc(count, sizeof(T));
    if (!memory) throw std::bad_alloc();
    return std::unique_ptr<T[], Zeros>(static_cast<T*>(memory));
  }
};

/// The nearest point at each pixel, of the points with one splat height.
class PixelImage {
 public:
  PixelImage(int tiles, int height)
      : tiles_(tiles),
        inverted_depth_(Zeros::make<std::int32_t>(std::size_t(tiles) * kTile * height)),
        used_(Zeros::make<std::uint8_t>(std::size_t(tiles) * height)) {}

  /// Thread-safe without a lock: the maximum does not depend on the order.
  void put(std::int32_t pixel, std::int32_t value) {
    std::int32_t* cell = &inverted_depth_[pixel];
    std::int32_t old = __atomic_load_n(cell, __ATOMIC_RELAXED);
    if (old >= value) return;
    while (old < value && !__atomic_compare_exchange_n(cell, &old, value, true, __ATOMIC_RELAXED,
                                                       __ATOMIC_RELAXED)) {
    }
    __atomic_store_n(&used_[pixel / kTile], std::uint8_t{1}, __ATOMIC_RELAXED);
  }

  const std::int32_t* row(int v) const { return &inverted_depth_[std::size_t(v) * tiles_ * kTile]; }
  const std::uint8_t* used(int v) const { return &used_[std::size_t(v) * tiles_]; }

 private:
  int tiles_;
  std::unique_ptr<std::int32_t[], Zeros> inverted_depth_;
  std::unique_ptr<std::uint8_t[], Zeros> used_;
};

/// One PixelImage for each height, made when the first point needs it.
class PixelImages {
 public:
  PixelImages(const Camera& camera, int largest)
      : tiles_((camera.width + kTile - 1) / kTile), height_(camera.height), images_(largest + 1) {}
  ~PixelImages() {
    for (auto& image : images_) delete image.load();
  }
  PixelImages(const PixelImages&) = delete;
  PixelImages& operator=(const PixelImages&) = delete;

  int tiles() const { return tiles_; }
  int largest() const { return static_cast<int>(images_.size()) - 1; }
  const PixelImage* find(int size) const { return images_[size].load(std::memory_order_relaxed); }

  PixelImage& at(int size) {
    PixelImage* image = images_[size].load(std::memory_order_acquire);
    return image ? *image : make(size);
  }

 private:
  PixelImage& make(int size) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!images_[size].load()) images_[size].store(new PixelImage(tiles_, height_));
    return *images_[size].load();
  }

  int tiles_, height_;
  std::mutex mutex_;
  std::vector<std::atomic<PixelImage*>> images_;
};

/// Camera in single precision. The tests repeat its operations in the same order.
struct Projection {
  float fx, fy, cx, cy, width, height;
  std::int32_t stride;
};

/// The points of a block in the image.
struct ProjectedSplat {
  std::int32_t pixel[Cloud::kBlock];  // negative outside
  float depth[Cloud::kBlock], squared[Cloud::kBlock];
};

// Written in lanes, since compilers do not vectorise this loop on their own.
struct ProjectBlock {
  DOCDEPTH_KERNEL static void run(const Cloud& cloud, const Cloud::Block& block,
                                  const RigidTransform& T, const Projection& camera,
                                  ProjectedSplat& out) {
    for (std::uint32_t i = 0; i < block.end - block.begin; i += kLanes) {
      const std::uint32_t at = block.begin + i;
      const auto [x, y, z] = moved(T, cloud.x() + at, cloud.y() + at, cloud.z() + at);
      const Floats u = ((camera.fx * x) / z + camera.cx) + 0.5f;
      const Floats v = ((camera.fy * y) / z + camera.cy) + 0.5f;
      const Ints seen =
          (z > kNear) & (u >= 0.0f) & (u < camera.width) & (v >= 0.0f) & (v < camera.height);
      // Visible coordinates are not negative, so truncating is rounding down.
      const Ints column = __builtin_convertvector(u, Ints) & seen;
      const Ints row = __builtin_convertvector(v, Ints) & seen;
      const Ints pixel = (row * camera.stride + column) | ~seen;
      const Floats squared = (x * x + y * y) + z * z;
      store(pixel, out.pixel + i);
      store(z, out.depth + i);
      store(squared, out.squared + i);
    }
  }
};

/// One step of the drawing loop.
struct VisibleBlock {
  std::uint32_t cloud, block;
};

std::vector<VisibleBlock> visible_blocks(const Camera& camera,
                                         const std::vector<PlacedCloud>& clouds, int threads) {
  std::vector<std::vector<VisibleBlock>> seen(clouds.size());
  parallel_for(clouds.size(), 8, threads, [&](std::size_t begin, std::size_t end) {
    for (std::size_t c = begin; c < end; ++c) {
      const Frustum frustum(camera, clouds[c].T_camera_cloud);
      const Cloud& cloud = *clouds[c].cloud;
      if (!cloud.size() || !frustum.touches(cloud.box())) continue;
      for (std::uint32_t b = 0; b < cloud.blocks().size(); ++b)
        if (frustum.touches(cloud.blocks()[b].box))
          seen[c].push_back({static_cast<std::uint32_t>(c), b});
    }
  });
  std::vector<VisibleBlock> all;
  for (const auto& blocks : seen) all.insert(all.end(), blocks.begin(), blocks.end());
  return all;
}

void draw_pixels(const Camera& camera, const std::vector<PlacedCloud>& clouds, PixelImages& images,
                 int threads) {
  const auto blocks = visible_blocks(camera, clouds, threads);
  std::vector<RigidTransform> transforms;
  for (const auto& placed : clouds) transforms.emplace_back(placed.T_camera_cloud);
  const Projection projection{float(camera.fx),      float(camera.fy),    float(camera.cx),
                              float(camera.cy),      float(camera.width), float(camera.height),
                              images.tiles() * kTile};
  parallel_for(blocks.size(), 64, threads, [&](std::size_t begin, std::size_t end) {
    ProjectedSplat points;
    for (std::size_t b = begin; b < end; ++b) {
      const std::uint32_t c = blocks[b].cloud;
      const Cloud& cloud = *clouds[c].cloud;
      const Cloud::Block& block = cloud.blocks()[blocks[b].block];
      dispatch<ProjectBlock>(cloud, block, transforms[c], projection, points);
      const SplatHeights& height = *clouds[c].heights;
      for (std::uint32_t i = 0; i < block.end - block.begin; ++i)
        if (points.pixel[i] >= 0)
          images.at(height(points.squared[i]))
              .put(points.pixel[i], inverted_bits(std::bit_cast<std::uint32_t>(points.depth[i])));
    }
  });
}

/// A row of the splats of one height.
struct Span {
  int size, dv;
};

std::vector<std::vector<Span>> spans_by_half_width(const PixelImages& images) {
  std::vector<std::vector<Span>> spans(1);
  for (int size = 0; size <= images.largest(); ++size) {
    if (!images.find(size)) continue;
    for (int dv = -size / 2; dv <= size / 2; ++dv) {
      std::size_t half = 0;
      while (9 * (half + 1) * (half + 1) + 4 * dv * dv <= std::size_t(size) * size) ++half;
      if (spans.size() <= half) spans.resize(half + 1);
      spans[half].push_back({size, dv});
    }
  }
  return spans;
}

DOCDEPTH_KERNEL void take_nearer(const std::int32_t* source, const std::uint8_t* used, int tiles,
                                 std::int32_t* row) {
  for (int tile = 0; tile < tiles; ++tile) {
    if (!used[tile]) continue;
    const std::int32_t* from = source + tile * kTile;
    std::int32_t* to = row + tile * kTile;
    for (int i = 0; i < kTile; ++i) to[i] = from[i] > to[i] ? from[i] : to[i];
  }
}

/// Widen a row by one pixel to both sides. The values before and behind a row are always 0.
DOCDEPTH_KERNEL void widen(const std::int32_t* row, int count, std::int32_t* wider) {
  for (int i = 0; i < count; ++i) {
    const std::int32_t sides = row[i - 1] > row[i + 1] ? row[i - 1] : row[i + 1];
    wider[i] = row[i] > sides ? row[i] : sides;
  }
}

/// Draws rows [begin, end) of the depth map. A row of half width w is a row of half width w - 1
/// made wider, so the rows of all heights are gathered from the widest down and widened together.
struct SpreadRows {
  DOCDEPTH_KERNEL static void run(const PixelImages& images,
                                  const std::vector<std::vector<Span>>& spans, int begin, int end,
                                  int image_height, int width, float* depth) {
    const int count = images.tiles() * kTile;
    std::vector<std::int32_t> first(count + 2), second(count + 2);
    for (int v = begin; v < end; ++v) {
      std::int32_t *row = first.data() + 1, *wider = second.data() + 1;
      std::fill(row, row + count, 0);
      for (std::size_t half = spans.size(); half-- > 0;) {
        for (const Span& span : spans[half]) {
          const int source = v - span.dv;
          if (source < 0 || source >= image_height) continue;
          const PixelImage* image = images.find(span.size);
          take_nearer(image->row(source), image->used(source), images.tiles(), row);
        }
        if (half) {
          widen(row, count, wider);
          std::swap(row, wider);
        }
      }
      float* out = depth + std::size_t(v) * width;
      for (int u = 0; u < width; ++u)
        out[u] = row[u] ? std::bit_cast<float>(kNearest - row[u])
                        : std::numeric_limits<float>::quiet_NaN();
    }
  }
};

int height_of(const SplatSize& size, float squared_distance) {
  const double squared = squared_distance;
  const double sigma = squared < kLargestSplatRange * kLargestSplatRange
                           ? size.max
                           : std::max(size.max / std::log(squared), size.min);
  return static_cast<int>(std::floor(sigma + 0.5));
}

}  // namespace

SplatHeights::SplatHeights(const SplatSize& size) {
  const int largest =
      std::max(height_of(size, 0),
               height_of(size, float(kLargestSplatRange) * float(kLargestSplatRange) + 1e-3f));
  constexpr std::uint32_t infinity = 0x7f800000;
  limit_.resize(largest + 1);
  for (int h = 0; h <= largest; ++h) {
    std::uint32_t reached = 0, missed = infinity;  // bits of floats, ordered like the floats
    while (missed - reached > 1) {
      const std::uint32_t middle = reached + (missed - reached) / 2;
      (height_of(size, std::bit_cast<float>(middle)) >= h ? reached : missed) = middle;
    }
    limit_[h] =
        missed == infinity ? std::numeric_limits<float>::infinity() : std::bit_cast<float>(reached);
  }
  guess_.resize((infinity >> 15) + 1);
  for (std::size_t pattern = 0, h = largest; pattern < guess_.size(); ++pattern) {
    const float begin = std::bit_cast<float>(static_cast<std::uint32_t>(pattern << 15));
    while (begin > limit_[h]) --h;
    guess_[pattern] = static_cast<std::uint16_t>(h);
  }
}

int SplatHeights::operator()(float squared_distance) const {
  int height = guess_[std::bit_cast<std::uint32_t>(squared_distance) >> 15];
  while (squared_distance > limit_[height]) --height;
  return height;
}

std::vector<float> render_splats(const Camera& camera, const std::vector<PlacedCloud>& clouds,
                                 int threads) {
  int largest = 0;
  for (const auto& placed : clouds) largest = std::max(largest, placed.heights->largest());
  PixelImages images(camera, largest);
  draw_pixels(camera, clouds, images, threads);

  const auto spans = spans_by_half_width(images);
  std::vector<float> depth(std::size_t(camera.width) * camera.height);
  parallel_for(camera.height, 16, threads, [&](std::size_t begin, std::size_t end) {
    dispatch<SpreadRows>(images, spans, static_cast<int>(begin), static_cast<int>(end),
                         camera.height, camera.width, depth.data());
  });
  return depth;
}

}  // namespace docdepth
