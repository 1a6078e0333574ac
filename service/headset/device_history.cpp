#include "service/headset/internal/device_history.h"

#include <algorithm>

namespace penumbra::service {

namespace {

constexpr Seconds kKept(2), kLargestGap(.1);

}  // namespace

void DeviceHistory::put(TimestampNs time, const HeadPose& pose) {
  const std::scoped_lock lock(mutex_);
  if (!samples_.empty() && time <= samples_.back().time) return;
  samples_.push_back({time, pose});
  while (time - samples_.front().time > kKept) samples_.pop_front();
}

std::optional<HeadPose> DeviceHistory::at(TimestampNs time) const {
  const std::scoped_lock lock(mutex_);
  const auto after = std::ranges::lower_bound(samples_, time, {}, &DeviceSample::time);
  if (after == samples_.end()) return std::nullopt;
  if (after->time == time) return after->pose;
  if (after == samples_.begin()) return std::nullopt;
  const DeviceSample& a = *std::prev(after);
  const DeviceSample& b = *after;
  if (b.time - a.time > kLargestGap) return std::nullopt;
  const double part = (time - a.time) / (b.time - a.time);
  const Pose &from = a.pose.world_from_device, &to = b.pose.world_from_device;
  return HeadPose{{glm::slerp(from.rotation, to.rotation, part),
                   from.translation + part * (to.translation - from.translation)},
                  a.pose.position_tracked && b.pose.position_tracked,
                  a.pose.rotation_tracked && b.pose.rotation_tracked};
}

std::optional<TimestampNs> DeviceHistory::newest() const {
  const std::scoped_lock lock(mutex_);
  if (samples_.empty()) return std::nullopt;
  return samples_.back().time;
}

void DeviceHistory::clear() {
  const std::scoped_lock lock(mutex_);
  samples_.clear();
}

}  // namespace penumbra::service
