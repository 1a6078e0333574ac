// Where frames wait for a light thread that is slower than its cameras.
#pragma once

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include "capture/capture.h"
#include "core/units.h"

namespace penumbra::service {

/// Holds the newest frame of each camera and exposure and hands them out in turn, so that no exposure of a bracket is
/// always the one that is dropped. A camera's frames stay in order of time.
/// threads: thread-safe, any number of writers and readers
class FrameMailbox {
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
        if (waiting_.size() == kMost) waiting_.erase(waiting_.begin()), ++dropped_;
        waiting_.push_back(std::move(frame));
      }
    }
    ready_.notify_one();
  }

  /// Waits for a frame until `timeout`; nothing after the timeout or once closed and empty.
  std::optional<capture::Frame> wait(Seconds timeout) {
    std::unique_lock lock(mutex_);
    ready_.wait_for(lock, timeout, [&] { return !waiting_.empty() || closed_; });
    if (waiting_.empty()) return std::nullopt;
    capture::Frame frame = std::move(waiting_.front());
    waiting_.erase(waiting_.begin());
    dropped_ += std::erase_if(waiting_, [&](const capture::Frame& other) {
      return other.camera == frame.camera && other.time < frame.time;
    });
    return frame;
  }

  void close() {
    {
      const std::scoped_lock lock(mutex_);
      closed_ = true;
    }
    ready_.notify_all();
  }
  bool closed() const {
    const std::scoped_lock lock(mutex_);
    return closed_;
  }
  std::uint64_t dropped() const {
    const std::scoped_lock lock(mutex_);
    return dropped_;
  }

 private:
  static constexpr std::size_t kMost = 16;
  // Within a quarter of a stop: labels that frames tell themselves vary a little.
  static bool alike(const capture::Frame& a, const capture::Frame& b) {
    return a.camera == b.camera &&
           std::abs(std::log2(a.exposure.product() / b.exposure.product())) < .25;
  }
  mutable std::mutex mutex_;
  std::condition_variable ready_;
  std::vector<capture::Frame> waiting_;  // whose turn came first stands first; guarded by mutex_
  std::uint64_t dropped_ = 0;
  bool closed_ = false;
};

}  // namespace penumbra::service
