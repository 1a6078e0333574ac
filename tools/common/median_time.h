// How long something takes on this machine, now.
#pragma once

#include <algorithm>
#include <chrono>
#include <vector>

namespace penumbra::tools {

/// Median of `runs` calls of work(), milliseconds; one more before them warms up.
double median_ms(int runs, const auto& work) {
  using Clock = std::chrono::steady_clock;
  work();
  std::vector<double> times;
  for (int i = 0; i < runs; ++i) {
    const auto begin = Clock::now();
    work();
    times.push_back(std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
  }
  const auto middle = times.begin() + runs / 2;
  std::nth_element(times.begin(), middle, times.end());
  return *middle;
}

}  // namespace penumbra::tools
