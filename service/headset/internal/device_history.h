// Where the head or a hand was lately.
// threads: thread-safe
#pragma once

#include <deque>
#include <mutex>
#include <optional>

#include "service/headset/headset.h"

namespace penumbra::service {

class DeviceHistory {
 public:
  /// Times rise; one that does not is left out.
  void put(TimestampNs time, const HeadPose& pose);
  /// Between two samples that are at most a tenth of a second apart: the rotation by a constant
  /// turn, the position along a line. Nothing outside.
  std::optional<HeadPose> at(TimestampNs time) const;
  std::optional<TimestampNs> newest() const;
  /// After the runtime has moved the world's origin.
  void clear();

 private:
  struct DeviceSample {
    TimestampNs time;
    HeadPose pose;
  };
  mutable std::mutex mutex_;
  std::deque<DeviceSample> samples_;  // guarded by mutex_
};

}  // namespace penumbra::service
