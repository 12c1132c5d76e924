// As many numbers at once as vector instructions take, each in a lane of its own. Also without
// such instructions they may be used as they are here.
#pragma once

#include <cstdint>

namespace docdepth {

constexpr int kLanes = 8;
using Floats = float __attribute__((vector_size(4 * kLanes)));
using Ints = std::int32_t __attribute__((vector_size(4 * kLanes)));

constexpr int kDoubleLanes = 4;
using Doubles = double __attribute__((vector_size(8 * kDoubleLanes)));

}  // namespace docdepth
