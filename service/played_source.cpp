#include "service/played_source.h"

#include <algorithm>
#include <chrono>
#include <thread>

namespace penumbra::service {

namespace {

using Clock = std::chrono::steady_clock;  // libstdc++'s is CLOCK_MONOTONIC

std::int64_t clock_ns() {
  return Clock::now().time_since_epoch().count();
}

}  // namespace

Result<std::optional<capture::Frame>> PlayedSource::next() {
  constexpr std::int64_t kMaxLate_ns = 250'000'000;
  auto frame = frames_->next();
  if (!frame || !*frame) return frame;
  TimestampNs& time = (*frame)->time;
  const std::int64_t now = clock_ns();
  if (!offset_ns_ || time.value + *offset_ns_ < now - kMaxLate_ns) offset_ns_ = now - time.value;
  time.value += *offset_ns_;
  constexpr auto kSlice = std::chrono::milliseconds(50);
  const Clock::time_point due{std::chrono::nanoseconds(time.value)};
  while (!closed_ && Clock::now() < due)
    std::this_thread::sleep_until(std::min(due, Clock::now() + kSlice));
  if (closed_) return std::nullopt;
  return frame;
}

}  // namespace penumbra::service
