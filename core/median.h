// The median of a few numbers.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// The upper one of an even number; at least one value. Reorders them.
inline double median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  return *middle;
}

}  // namespace penumbra::capture
#pragma GCC visibility pop
