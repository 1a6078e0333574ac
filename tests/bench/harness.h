// Paired timing: ours and the peer alternate in one run, so that a noisy machine hits both alike.
#pragma once

#include <benchmark/benchmark.h>
#include <oneapi/tbb/global_control.h>

#include <algorithm>
#include <chrono>
#include <opencv2/core.hpp>
#include <vector>

namespace penumbra::bench {

/// Limits TBB and OpenCV to `n` threads while it lives.
class Threads {
 public:
  explicit Threads(int n)
      : limit_(tbb::global_control::max_allowed_parallelism, static_cast<std::size_t>(n)) {
    cv::setNumThreads(n);
  }

 private:
  tbb::global_control limit_;
};

template <class F>
double time_ms(F&& run) {
  const auto start = std::chrono::steady_clock::now();
  run();
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start)
      .count();
}

inline double median(std::vector<double> v) {
  std::ranges::sort(v);
  return v[v.size() / 2];
}

inline constexpr int kRepeats = 9;

/// Runs both kRepeats times in turn; counters ours_ms, peer_ms and ratio = peer/ours (medians).
template <class Ours, class Peer>
void compare(benchmark::State& state, Ours&& ours, Peer&& peer) {
  ours();
  peer();
  std::vector<double> a, b;
  for (auto _ : state) {
    a.push_back(time_ms(ours));
    b.push_back(time_ms(peer));
    state.SetIterationTime(a.back() * 1e-3);
  }
  state.counters["ours_ms"] = median(a);
  state.counters["peer_ms"] = median(b);
  state.counters["ratio"] = median(b) / median(a);
}

/// Registration with one and two threads, as every figure is wanted.
inline void one_and_two_threads(benchmark::internal::Benchmark* b) {
  b->Arg(1)->Arg(2)->ArgName("threads")->Iterations(kRepeats)->UseManualTime()->Unit(
      benchmark::kMillisecond);
}

}  // namespace penumbra::bench
