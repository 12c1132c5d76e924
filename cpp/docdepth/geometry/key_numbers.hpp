// Numbers for keys, such as those of voxels.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace docdepth {

/// Numbers keys in the order in which they come. Far faster here than std::unordered_map.
class KeyNumbers {
 public:
  static constexpr std::uint32_t kNone = ~0u;

  explicit KeyNumbers(std::size_t expected = 0) {
    std::size_t slots = 8;
    while (slots < 2 * expected) slots *= 2;
    slots_.resize(slots, kNone);
    keys_.reserve(expected);
  }

  std::size_t size() const { return keys_.size(); }

  /// Number of a key; a new key gets the next one.
  std::uint32_t operator[](std::uint64_t key) {
    if (2 * keys_.size() >= slots_.size()) grow();
    std::uint32_t& slot = slots_[slot_of(key)];
    if (slot == kNone) {
      slot = static_cast<std::uint32_t>(keys_.size());
      keys_.push_back(key);
    }
    return slot;
  }

  /// Number of a key, or kNone.
  std::uint32_t find(std::uint64_t key) const { return slots_[slot_of(key)]; }

 private:
  /// Where a key is, or would be.
  std::size_t slot_of(std::uint64_t key) const {
    const std::size_t mask = slots_.size() - 1;
    std::size_t slot = (key * 0x9E3779B97F4A7C15u) >> 32 & mask;
    while (slots_[slot] != kNone && keys_[slots_[slot]] != key) slot = (slot + 1) & mask;
    return slot;
  }

  void grow() {
    slots_.assign(2 * slots_.size(), kNone);
    for (std::size_t i = 0; i < keys_.size(); ++i)
      slots_[slot_of(keys_[i])] = static_cast<std::uint32_t>(i);
  }

  std::vector<std::uint32_t> slots_;
  std::vector<std::uint64_t> keys_;
};

}  // namespace docdepth
