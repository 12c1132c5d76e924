// Identity of shapes, by which the OpenGL renderer finds its copies on the device.
#pragma once

#include <atomic>
#include <cstdint>

namespace docdepth {

/// A number that no other call returns. Copies of a shape share it.
inline std::uint64_t new_identity() {
  static std::atomic<std::uint64_t> given{0};
  return ++given;
}

}  // namespace docdepth
