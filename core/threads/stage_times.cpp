#include "core/threads/stage_times.h"

#include <algorithm>
#include <cmath>

namespace penumbra {

void StageTimes::add(std::string_view stage, double ms) {
  const std::scoped_lock lock(mutex_);
  auto found = std::ranges::find(stages_, stage, &Stage::name);
  if (found == stages_.end()) {
    found = stages_.insert(stages_.end(), Stage{std::string(stage), {}, 0});
    // No frame pays for more room later; the system gives the memory when it is written to.
    found->ms.reserve(kMaxSamples);
  }
  if (found->ms.size() < kMaxSamples) {
    found->ms.push_back(static_cast<float>(ms));
  } else {
    found->ms[found->next++ % kMaxSamples] = static_cast<float>(ms);
  }
}

std::vector<std::pair<std::string, StageTimes::Percentiles>> StageTimes::summary() const {
  // Sorted outside the lock: whoever asks must not hold up the stages.
  std::vector<Stage> stages;
  {
    const std::scoped_lock lock(mutex_);
    stages = stages_;
  }
  std::vector<std::pair<std::string, Percentiles>> out;
  for (const Stage& stage : stages) {
    std::vector<float> sorted = stage.ms;
    std::ranges::sort(sorted);
    const auto at = [&](double fraction) {
      const auto rank =
          static_cast<std::size_t>(std::ceil(fraction * static_cast<double>(sorted.size())));
      return static_cast<double>(sorted[std::clamp<std::size_t>(rank, 1, sorted.size()) - 1]);
    };
    out.emplace_back(stage.name, Percentiles{at(.5), at(.99), sorted.size()});
  }
  return out;
}

}  // namespace penumbra
