// Vectorised kernels. One binary serves old and new processors: each kernel is compiled twice, for
// AVX2 and for the baseline, and the version is chosen at run time. Both are the same source
// without fused operations (CMakeLists.txt), so their results are the same bits. That is also why
// no library is used: where a processor has fused operations, they take them.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <utility>

// All of this is inlined, so it does not matter how vectors would be passed to functions.
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"
#endif

namespace docdepth {

#if defined(__x86_64__) && defined(__GNUC__)
#define DOCDEPTH_TARGET_AVX2 __attribute__((target("avx2")))
inline bool has_avx2() {
  static const bool has = __builtin_cpu_supports("avx2");
  return has;
}
#else
#define DOCDEPTH_TARGET_AVX2
inline bool has_avx2() {
  return false;
}
#endif

/// Marks every function that a kernel calls, so that it is compiled again with the kernel.
#define DOCDEPTH_KERNEL __attribute__((always_inline)) inline

template <class Kernel, class... Arguments>
DOCDEPTH_TARGET_AVX2 void run_avx2(Arguments&&... arguments) {
  Kernel::run(std::forward<Arguments>(arguments)...);
}

/// Call Kernel::run, a DOCDEPTH_KERNEL, with AVX2 instructions where the processor has them.
template <class Kernel, class... Arguments>
void dispatch(Arguments&&... arguments) {
  if (has_avx2()) {
    run_avx2<Kernel>(std::forward<Arguments>(arguments)...);
  } else {
    Kernel::run(std::forward<Arguments>(arguments)...);
  }
}

/// Call body(i) for each i with a negative flag. Few flags are negative, so groups are skipped.
template <class Body>
void for_each_flagged(std::size_t count, const std::int32_t* flags, const Body& body) {
  constexpr std::size_t kGroup = 16;
  for (std::size_t begin = 0; begin < count; begin += kGroup) {
    const std::size_t end = begin + kGroup < count ? begin + kGroup : count;
    std::int32_t any = 0;
    if (end - begin == kGroup) {
      for (std::size_t j = 0; j < kGroup; ++j) any |= flags[begin + j];
      if (any >= 0) continue;
    }
    for (std::size_t i = begin; i < end; ++i)
      if (flags[i] < 0) body(i);
  }
}

/// Vectors of the compiler, one value per lane. Without AVX2 each is two registers.
constexpr int kLanes = 8;
using Floats = float __attribute__((vector_size(4 * kLanes)));
using Ints = std::int32_t __attribute__((vector_size(4 * kLanes)));

constexpr int kDoubleLanes = 4;
using Doubles = double __attribute__((vector_size(8 * kDoubleLanes)));

/// Lanes from memory and to it, however it is aligned.
template <class Lanes = Floats, class Value>
DOCDEPTH_KERNEL Lanes load(const Value* from) {
  Lanes lanes;
  std::memcpy(&lanes, from, sizeof lanes);
  return lanes;
}
template <class Lanes, class Value>
DOCDEPTH_KERNEL void store(const Lanes& lanes, Value* to) {
  std::memcpy(to, &lanes, sizeof lanes);
}

/// Eight vectors, one per lane.
struct Vectors {
  Floats x, y, z;
};

/// Eight points of consecutive columns as RigidTransform moves them.
template <class Transform>
DOCDEPTH_KERNEL Vectors moved(const Transform& T, const float* x, const float* y, const float* z) {
  const Floats a = load(x), b = load(y), c = load(z);
  return {((T.r[0][0] * a + T.r[0][1] * b) + T.r[0][2] * c) + T.t[0],
          ((T.r[1][0] * a + T.r[1][1] * b) + T.r[1][2] * c) + T.t[1],
          ((T.r[2][0] * a + T.r[2][1] * b) + T.r[2][2] * c) + T.t[2]};
}

DOCDEPTH_KERNEL Floats absolute(const Floats& v) {
  return v < 0.0f ? -v : v;
}

DOCDEPTH_KERNEL Floats root(const Floats& v) {
  Floats roots;
  for (int lane = 0; lane < kLanes; ++lane) roots[lane] = std::sqrt(v[lane]);
  return roots;
}

/// Whether any lane is true.
DOCDEPTH_KERNEL bool any(const Ints& lanes) {
  std::int64_t halves[kLanes / 2];
  std::memcpy(halves, &lanes, sizeof lanes);
  return (halves[0] | halves[1] | halves[2] | halves[3]) != 0;
}

}  // namespace docdepth
