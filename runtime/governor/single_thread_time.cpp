#include "runtime/governor/single_thread_time.h"

#include <tbb/global_control.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <vector>

namespace penumbra::runtime {

LightTime time_single_threaded(int runs, const std::function<void(int)>& work, double max_ms) {
  const tbb::global_control one_thread(tbb::global_control::max_allowed_parallelism, 1);
  std::vector<double> ms;
  double all_ms = 0;
  for (int run = 0; run < runs && (run == 0 || all_ms < max_ms); ++run) {
    const auto start = std::chrono::steady_clock::now();
    work(run);
    ms.push_back(std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start)
                     .count());
    all_ms += ms.back();
  }
  std::ranges::sort(ms);
  const auto last = static_cast<double>(ms.size() - 1);
  return {ms[ms.size() / 2], ms[static_cast<std::size_t>(std::lround(.99 * last))]};
}

}  // namespace penumbra::runtime
