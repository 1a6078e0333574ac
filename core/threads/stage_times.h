// Durations of named stages, for percentiles in summaries.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#pragma GCC visibility push(default)
namespace penumbra {

/// threads: thread-safe
class StageTimes {
 public:
  struct Percentiles {
    double p50_ms = 0, p99_ms = 0;  // of the last kLastSamples
    std::uint64_t count = 0;        // of all
  };

  /// How often a stage took how long, since the start.
  struct Histogram {
    static constexpr std::array kUpTo_ms{.5, 1., 2., 4., 8., 16., 33., 66., 133., 266., 1000.};
    std::array<std::uint64_t, kUpTo_ms.size()> counts{};  // not more than that, and than no smaller
    std::uint64_t count = 0;                              // of all
    double sum_ms = 0;
  };

  static constexpr std::size_t kLastSamples = 1 << 14;  // nine minutes of 30 a second

  void add(std::string_view stage, double ms);
  /// In order of first use.
  std::vector<std::pair<std::string, Percentiles>> summary() const;
  std::vector<std::pair<std::string, Histogram>> histograms() const;

 private:
  struct Stage {
    std::string name;
    std::vector<float> ms;
    std::size_t next = 0;
    Histogram histogram{};
  };
  mutable std::mutex mutex_;
  std::vector<Stage> stages_;  // guarded by mutex_
};

/// Time since construction.
class Stopwatch {
 public:
  double ms() const {
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start_)
        .count();
  }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

/// Adds the time from construction to destruction.
/// in: stage, which must live as long as the timer
class StageTimer {
 public:
  StageTimer(StageTimes& times, std::string_view stage) : times_(times), stage_(stage) {}
  StageTimer(const StageTimer&) = delete;
  StageTimer& operator=(const StageTimer&) = delete;
  ~StageTimer() { times_.add(stage_, watch_.ms()); }

 private:
  StageTimes& times_;
  std::string_view stage_;
  Stopwatch watch_;
};

}  // namespace penumbra
#pragma GCC visibility pop
