// Freed memory stays for the next run, as the command line has it (python/docdepth/cli).
#pragma once

#ifdef __GLIBC__
#include <malloc.h>
#endif

inline void keep_memory() {
#ifdef __GLIBC__
  mallopt(M_TRIM_THRESHOLD, 1 << 30);
  mallopt(M_TOP_PAD, 1 << 26);
  mallopt(M_MMAP_THRESHOLD, 1 << 25);
  mallopt(M_ARENA_MAX, 1);
#endif
}
