// Where frames wait for a light thread that is slower than its cameras.
#pragma once

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "capture/frames.h"
#include "core/threads/queues.h"
#include "core/units.h"

namespace penumbra::runtime {

/// Holds the newest frame of each camera and exposure and hands them out in turn, so that no
/// exposure of a bracket is always the one that is dropped. A camera's frames stay in order of
/// time.
/// threads: thread-safe, any number of writers and readers
class FrameMailbox : public Closable {
 public:
  void put(capture::Frame frame) {
    {
      const std::scoped_lock lock(mutex_);
      if (closed_) return;
      const auto before = std::ranges::find_if(
          waiting_, [&](const capture::Frame& other) { return alike(other, frame); });
      if (before != waiting_.end()) {
        *before = std::move(frame);
        ++dropped_;
      } else {
        if (waiting_.size() == kMax) waiting_.erase(waiting_.begin()), ++dropped_;
        waiting_.push_back(std::move(frame));
      }
    }
    changed_.notify_one();
  }

  /// Waits for a frame until `timeout`; nothing after the timeout or once closed and empty.
  std::optional<capture::Frame> wait(Seconds timeout) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout, [&] { return !waiting_.empty() || closed_; });
    if (waiting_.empty()) return std::nullopt;
    capture::Frame frame = std::move(waiting_.front());
    waiting_.erase(waiting_.begin());
    dropped_ += std::erase_if(waiting_, [&](const capture::Frame& other) {
      return other.camera == frame.camera && other.time < frame.time;
    });
    return frame;
  }

 private:
  static constexpr std::size_t kMax = 16;
  // Within a quarter of a stop: labels that frames tell themselves vary a little.
  static bool alike(const capture::Frame& a, const capture::Frame& b) {
    return a.camera == b.camera &&
           std::abs(std::log2(a.exposure.product() / b.exposure.product())) < .25;
  }
  std::vector<capture::Frame> waiting_;  // whose turn came first stands first; guarded by mutex_
};

}  // namespace penumbra::runtime
