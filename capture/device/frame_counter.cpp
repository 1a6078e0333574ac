#include <algorithm>
#include <cmath>

#include "capture/device/internal/bracketed_camera.h"
#include "core/median.h"

namespace penumbra::capture {

std::uint64_t FrameCounter::at(TimestampNs time) const {
  const double passed = period_ > 0 ? std::floor(((time - time_).count() - latency_) / period_) : 0;
  return number_ + static_cast<std::uint64_t>(std::clamp(passed, 0., 1000.));
}

// Drivers stamp a frame when it begins; it arrives up to a period or two later.
Seconds FrameCounter::fresh() const {
  constexpr double kSoon = .4;  // of a period
  return Seconds(period_ > 0 ? latency_ + kSoon * period_ : 1e9);
}

std::uint64_t FrameCounter::count(std::uint64_t sequence, TimestampNs time, TimestampNs arrived) {
  // Of a period a frame: what grew is believed after a second or two
  constexpr double kForget = .02;
  latency_ = std::min(latency_ + kForget * period_, std::max(0., (arrived - time).count()));
  constexpr std::size_t kFewestPeriods = 5, kPeriods = 15;
  constexpr std::uint64_t kMaxMissing = 600;  // a longer gap is a new start
  if (!sequence_) {
    sequence_ = sequence, time_ = time;
    return number_;
  }
  const double apart = (time - time_).count();
  std::uint64_t step = sequence > *sequence_ ? sequence - *sequence_ : 1;
  // Late delivery moves a time by less than half a period.
  if (period_ > 0 && std::round(apart / period_) > static_cast<double>(step))
    step = static_cast<std::uint64_t>(std::min(apart / period_ + .5, double{kMaxMissing}));
  step = std::min(step, kMaxMissing);
  periods_.push_back(apart / static_cast<double>(step));
  if (periods_.size() > kPeriods) periods_.pop_front();
  if (periods_.size() >= kFewestPeriods) {
    std::vector<double> all(periods_.begin(), periods_.end());
    period_ = median(all);
  }
  lost_ += step - 1;
  number_ += step;
  sequence_ = sequence, time_ = time;
  return number_;
}

}  // namespace penumbra::capture
