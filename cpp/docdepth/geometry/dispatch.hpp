// Kernels for whatever vectors the processor has.
#pragma once

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

}  // namespace docdepth
