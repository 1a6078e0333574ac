// What a process spends its processor time on, by the threads that say so and by the parallel loops
// that they start. What libraries do on threads of their own is other, and what they hand to the
// threads of loops, as Embree does, counts for the loop that such a thread did last.
// threads: thread-safe
#pragma once

#include <cstdint>

#pragma GCC visibility push(default)
namespace penumbra {

enum class ProcessorUse : std::uint8_t { kOther, kCameras, kPipeline, kEncoding };
inline constexpr int kProcessorUses = 4;

/// What the calling thread does from now on counts for a use. Threads that never say are kOther.
void spend_on(ProcessorUse use);
/// Of the calling thread.
ProcessorUse spending_on();

/// While it lives, what the calling thread does counts for a use, and so do the parts of parallel
/// loops that it starts, whoever does them. Of two such the inner one counts.
/// threads: thread-bound
class SpendingOn {
 public:
  explicit SpendingOn(ProcessorUse use) : before_(spending_on()) { spend_on(use); }
  ~SpendingOn() { spend_on(before_); }
  SpendingOn(const SpendingOn&) = delete;
  SpendingOn& operator=(const SpendingOn&) = delete;

 private:
  ProcessorUse before_;
};

/// Milliseconds of all cores so far.
struct ProcessorTimes {
  double pipeline_ms = 0;
  double drawing_ms = 0;   // threads of OpenGL without a GPU (Mesa's llvmpipe) that live
  double cameras_ms = 0;   // that are read, or that a studio films
  double encoding_ms = 0;  // pictures and videos, and writing them
  double other_ms = 0;

  friend ProcessorTimes operator-(const ProcessorTimes& a, const ProcessorTimes& b) {
    return {a.pipeline_ms - b.pipeline_ms, a.drawing_ms - b.drawing_ms, a.cameras_ms - b.cameras_ms,
            a.encoding_ms - b.encoding_ms, a.other_ms - b.other_ms};
  }
};
ProcessorTimes processor_times();

}  // namespace penumbra
#pragma GCC visibility pop
