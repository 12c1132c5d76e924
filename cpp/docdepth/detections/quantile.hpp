// Quantiles of a few values.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace docdepth {

/// The value below which this share of the values lies; 0.5: the median, the upper one of two.
template <class Value>
Value quantile(std::vector<Value> values, double share) {
  const auto k = static_cast<std::size_t>(share * double(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), values.begin() + std::ptrdiff_t(k), values.end());
  return values[k];
}

}  // namespace docdepth
