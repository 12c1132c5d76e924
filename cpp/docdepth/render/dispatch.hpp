// One binary for old and new processors: a plain function compiled twice, chosen when it runs.
#pragma once

#if (defined(__x86_64__) || defined(__i386__)) && defined(__GNUC__)
#define DOCDEPTH_AVX2 __attribute__((target("avx2")))
#define DOCDEPTH_HAS_AVX2() __builtin_cpu_supports("avx2")
#else
#define DOCDEPTH_AVX2
#define DOCDEPTH_HAS_AVX2() false
#endif

/// Both versions are the same source without fused operations, so their results are the same bits.
#define DOCDEPTH_INLINE inline __attribute__((always_inline))
