// How a copy on a graphics card is found again.
#pragma once

#include <atomic>
#include <cstdint>

namespace docdepth {

/// A number that no other call gets, and that copies of its owner share.
inline std::uint64_t new_identity() {
  static std::atomic<std::uint64_t> given{0};
  return ++given;
}

}  // namespace docdepth
