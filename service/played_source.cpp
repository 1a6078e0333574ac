#include "service/played_source.h"

#include <chrono>

namespace penumbra::service {

Result<std::optional<capture::Frame>> PlayedSource::next() {
  auto frame = frames_->next();
  if (!frame || !*frame) return frame;
  TimestampNs& time = (*frame)->time;
  // libstdc++'s steady clock is CLOCK_MONOTONIC.
  if (!offset_ns_)
    offset_ns_ = std::chrono::steady_clock::now().time_since_epoch().count() - time.value;
  time.value += *offset_ns_;
  return frame;
}

}  // namespace penumbra::service
