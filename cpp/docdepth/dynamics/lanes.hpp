// A row of a window at a time, each pixel in a lane of its own.
#pragma once

#include <cstdint>

namespace docdepth {

constexpr int kLanes = 8;
using Floats = float __attribute__((vector_size(4 * kLanes)));
using Ints = std::int32_t __attribute__((vector_size(4 * kLanes)));

}  // namespace docdepth
