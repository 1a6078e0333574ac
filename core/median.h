// Medians of a few numbers.
// threads: reentrant
#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <span>
#include <tuple>
#include <vector>

#pragma GCC visibility push(default)
namespace penumbra {

/// The upper one of an even number; at least one value. Reorders them.
inline double median(std::span<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  return *middle;
}

/// A value, or a bound below it: a saturated pixel has at least what it shows.
struct CensoredValue {
  float value = 0;
  bool at_least = false;
};

/// Where the product-limit estimate of the fraction above falls to one half: with bounds alone a
/// plain median would be too low, and one without them too low as well. Nothing where bounds leave
/// it open. Reorders the values.
/// source: Kaplan & Meier 1958
inline std::optional<float> censored_median(std::vector<CensoredValue>& values) {
  std::ranges::sort(values, {},
                    [](const CensoredValue& v) { return std::tuple(v.value, v.at_least); });
  double above = 1;
  auto remaining = static_cast<double>(values.size());
  for (const CensoredValue& v : values) {
    if (!v.at_least) above *= 1 - 1 / remaining;
    --remaining;
    if (above <= .5) return v.value;
  }
  return std::nullopt;
}

}  // namespace penumbra
#pragma GCC visibility pop
