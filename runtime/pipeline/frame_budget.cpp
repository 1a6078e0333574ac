#include "runtime/pipeline/internal/frame_budget.h"

#include <algorithm>
#include <utility>

namespace penumbra::runtime {

void FrameBudget::add(double busy_ms, int lights) {
  if (!(period_ms_ > 0)) return;
  const int before = std::exchange(last_lights_, lights);
  // A light that has not followed yet says nothing; one that has just got a light more is on trial.
  if (lights > allowed_ || (lights > before && window_ != kTrial)) frames_ = 0, even_ = true;
  if (lights > allowed_) return;
  if (lights > before) window_ = kTrial;
  even_ = even_ && (frames_ == 0 || lights == lights_);
  lights_ = frames_ == 0 ? lights : std::max(lights_, lights);
  busy_ms_[static_cast<std::size_t>(frames_)] = busy_ms;
  if (++frames_ < window_) return;
  const auto middle = busy_ms_.begin() + window_ / 2;
  std::nth_element(busy_ms_.begin(), middle, busy_ms_.begin() + window_);
  window_ = kWindow;
  decide(*middle);
  frames_ = 0;
  even_ = true;
}

void FrameBudget::start_over() {
  allow_all();
  frames_ = 0, even_ = true, window_ = kTrial;
  next_wait_ = kShortestWait, quiet_ = 0;
}

void FrameBudget::decide(double median_ms) {
  if (++quiet_ >= kQuietWaits * next_wait_) {
    next_wait_ = std::max(kShortestWait, next_wait_ / 2);
    quiet_ = 0;
  }
  unused_ = allowed_ != kAll && lights_ < allowed_ ? unused_ + 1 : 0;
  if (median_ms > period_ms_ && lights_ > 0)
    give_one_up(median_ms);
  else if (unused_ == kUnused)
    allow_all();
  else if (lights_ == allowed_ && even_)
    take_one_back(median_ms);
}

void FrameBudget::give_one_up(double median_ms) {
  allowed_ = std::min(allowed_, lights_) - 1;
  window_ = kTrial;
  with_ms_ = median_ms;
  light_cost_ms_.reset();
  wait_ = next_wait_;
  next_wait_ = std::min(2 * next_wait_, kLongestWait);
  quiet_ = 0;
}

void FrameBudget::take_one_back(double median_ms) {
  if (with_ms_ && !light_cost_ms_) light_cost_ms_ = std::max(0., *with_ms_ - median_ms);
  if (wait_ > 0 && --wait_ > 0) return;
  if (!light_cost_ms_) return;
  if (median_ms + *light_cost_ms_ < kRoom * period_ms_) {
    ++allowed_;
    with_ms_.reset();
  } else {
    // It may have cost less: what else the machine did then nobody knows.
    wait_ = next_wait_;
    *light_cost_ms_ *= kCostDecay;
  }
}

// What did not fit then is not what comes next.
void FrameBudget::allow_all() {
  allowed_ = kAll;
  with_ms_.reset(), light_cost_ms_.reset();
  wait_ = unused_ = 0;
}

}  // namespace penumbra::runtime
