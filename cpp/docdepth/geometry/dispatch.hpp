// Kernels for whatever vectors the processor has.
#pragma once

#include <cstddef>
#include <cstdint>

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

/// Mark what a kernel calls, so that it is compiled again together with the kernel.
#define DOCDEPTH_KERNEL __attribute__((always_inline)) inline

template <class Kernel, class... Arguments>
DOCDEPTH_TARGET_AVX2 void run_avx2(Arguments... arguments) {
  Kernel::run(arguments...);
}

/// Call Kernel::run, a DOCDEPTH_KERNEL made of plain loops that compilers turn into vector
/// instructions: those of AVX2 where the processor has them, else those that every one has.
/// Without contraction (CMakeLists.txt) both round alike.
template <class Kernel, class... Arguments>
void dispatch(Arguments... arguments) {
  if (has_avx2()) {
    run_avx2<Kernel>(arguments...);
  } else {
    Kernel::run(arguments...);
  }
}

/// Call body(i) for the few i whose flag is negative, passing over the others by the dozen.
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

}  // namespace docdepth
