#include "core/threads/stage_times.h"

#include <algorithm>
#include <cmath>

namespace penumbra {

void StageTimes::add(std::string_view stage, double ms) {
  const std::scoped_lock lock(mutex_);
  auto found = std::ranges::find(stages_, stage, &Stage::name);
  if (found == stages_.end()) {
    found = stages_.insert(stages_.end(), Stage{std::string(stage), {}, 0, {}});
    // No frame pays for more room later; the system gives the memory when it is written to.
    found->ms.reserve(kLastSamples);
  }
  Histogram& h = found->histogram;
  const auto bin = std::ranges::lower_bound(Histogram::kUpTo_ms, ms);
  if (bin != Histogram::kUpTo_ms.end())
    ++h.counts[static_cast<std::size_t>(bin - Histogram::kUpTo_ms.begin())];
  ++h.count;
  h.sum_ms += ms;
  if (found->ms.size() < kLastSamples) {
    found->ms.push_back(static_cast<float>(ms));
  } else {
    found->ms[found->next++ % kLastSamples] = static_cast<float>(ms);
  }
}

std::vector<std::pair<std::string, StageTimes::Percentiles>> StageTimes::summary() const {
  // Ranked outside the lock: whoever asks must not hold up the stages.
  std::vector<Stage> stages;
  {
    const std::scoped_lock lock(mutex_);
    stages = stages_;
  }
  std::vector<std::pair<std::string, Percentiles>> out;
  for (Stage& stage : stages) {
    std::vector<float>& ms = stage.ms;
    const auto at = [&](double fraction) {
      const auto rank =
          static_cast<std::size_t>(std::ceil(fraction * static_cast<double>(ms.size())));
      const auto place =
          static_cast<std::ptrdiff_t>(std::clamp<std::size_t>(rank, 1, ms.size()) - 1);
      std::ranges::nth_element(ms, ms.begin() + place);
      return static_cast<double>(ms[static_cast<std::size_t>(place)]);
    };
    const double median = at(.5);
    out.emplace_back(stage.name, Percentiles{median, at(.99), stage.histogram.count});
  }
  return out;
}

std::vector<std::pair<std::string, StageTimes::Histogram>> StageTimes::histograms() const {
  const std::scoped_lock lock(mutex_);
  std::vector<std::pair<std::string, Histogram>> out;
  for (const Stage& stage : stages_) out.emplace_back(stage.name, stage.histogram);
  return out;
}

}  // namespace penumbra
