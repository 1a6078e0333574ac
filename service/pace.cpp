#include "service/pace.h"

#include <algorithm>

namespace penumbra::service {

void Pace::add(double busy_ms, int discs) {
  if (!(period_ms_ > 0)) return;
  // The light follows with a frame of the environment's: frames of before do not count.
  if (discs != discs_) sum_ms_ = 0, frames_ = 0, discs_ = discs;
  sum_ms_ += busy_ms;
  if (++frames_ < kWindow) return;
  decide(sum_ms_ / frames_, discs);
  sum_ms_ = 0, frames_ = 0;
}

void Pace::decide(double mean_ms, int discs) {
  if (mean_ms > period_ms_ && discs > 0) {
    allowed_ = std::min(allowed_, discs) - 1;
    with_ms_ = mean_ms;
    disc_cost_ms_.reset();
    wait_ = next_wait_;
    next_wait_ = std::min(2 * next_wait_, kLongestWait);
    return;
  }
  if (allowed_ == kAll || discs > allowed_) return;
  if (with_ms_ && !disc_cost_ms_) disc_cost_ms_ = std::max(0., *with_ms_ - mean_ms);
  if (wait_ > 0 && --wait_ > 0) return;
  if (disc_cost_ms_ && mean_ms + *disc_cost_ms_ < kRoom * period_ms_) {
    ++allowed_;
    with_ms_.reset();
  }
}

}  // namespace penumbra::service
