// How long work takes on one thread of this machine, now.
// threads: thread-bound; holds all parallel work of the process to one thread meanwhile
#pragma once

#include <functional>
#include <limits>

namespace penumbra::runtime {

struct LightTime {
  double p50_ms = 0, p99_ms = 0;
};

/// Median and 99th percentile of so many runs of `work` on one thread; no further run begins once
/// all together have taken max_ms.
LightTime time_single_threaded(int runs, const std::function<void(int run)>& work,
                               double max_ms = std::numeric_limits<double>::infinity());

}  // namespace penumbra::runtime
