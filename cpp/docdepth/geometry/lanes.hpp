// As many numbers at once as vector instructions take, each in a lane of its own. Also without
// such instructions they may be used as they are here.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#include "docdepth/geometry/dispatch.hpp"

// All of this is inlined, so it does not matter how vectors would be passed to functions.
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"
#endif

namespace docdepth {

constexpr int kLanes = 8;
using Floats = float __attribute__((vector_size(4 * kLanes)));
using Ints = std::int32_t __attribute__((vector_size(4 * kLanes)));

constexpr int kDoubleLanes = 4;
using Doubles = double __attribute__((vector_size(8 * kDoubleLanes)));

DOCDEPTH_KERNEL Floats load(const float* from) {
  Floats lanes;
  std::memcpy(&lanes, from, sizeof lanes);
  return lanes;
}

DOCDEPTH_KERNEL Floats absolute(const Floats& v) {
  return v < 0.0f ? -v : v;
}

DOCDEPTH_KERNEL Floats root(const Floats& v) {
  Floats roots;
  for (int lane = 0; lane < kLanes; ++lane) roots[lane] = std::sqrt(v[lane]);
  return roots;
}

}  // namespace docdepth
