// Where view frames wait for the compositing thread: those of two eyes together.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "capture/frames.h"
#include "core/threads/queues.h"
#include "core/units.h"

namespace penumbra::runtime {

/// Holds the newest frame of each view camera; a left and a right eye are handed out together, as
/// they were filmed at one moment. An eye whose other one brings nothing goes alone.
/// threads: thread-safe, one writer and one reader
class ViewMailbox : public Closable {
 public:
  /// period: between two frames of a camera; eyes less than half of it apart belong together. 0:
  /// unknown, a thirtieth of a second
  ViewMailbox(const std::vector<capture::CameraInfo>& cameras, Seconds period)
      : tolerance_(period.count() > 0 ? period / 2 : Seconds(1. / 60)) {
    const auto eye = [&](const char* name) {
      const auto found = std::ranges::find_if(cameras, [&](const capture::CameraInfo& c) {
        return c.role == capture::Role::kView && c.eye == name;
      });
      return static_cast<std::size_t>(found - cameras.begin());
    };
    const std::size_t left = eye("left"), right = eye("right");
    const bool paired = left < cameras.size() && right < cameras.size();
    group_of_.resize(cameras.size());
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      if (paired && i == std::max(left, right)) {
        group_of_[i] = {group_of_[std::min(left, right)].group, i == right ? 1u : 0u};
        groups_[group_of_[i].group].eyes = 2;
      } else {
        group_of_[i] = {groups_.size(), paired && i == right ? 1u : 0u};
        groups_.emplace_back();
      }
    }
  }

  void put(capture::Frame frame) {
    {
      const std::scoped_lock lock(mutex_);
      if (closed_) return;
      const EyeOfGroup place = group_of_[static_cast<std::size_t>(frame.camera)];
      Group& group = groups_[place.group];
      if (group.eyes == 1)
        hand_on(group, {std::move(frame), std::nullopt});
      else
        match(group, place.eye, std::move(frame));
    }
    changed_.notify_one();
  }

  bool waiting() const {
    const std::scoped_lock lock(mutex_);
    return next() < groups_.size();
  }

  /// The frames of one moment, left before right; nothing after the timeout or once closed and
  /// empty.
  std::vector<capture::Frame> wait(Seconds timeout) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout, [&] { return next() < groups_.size() || closed_; });
    std::vector<capture::Frame> out;
    if (const std::size_t group = next(); group < groups_.size())
      for (auto& frame : groups_[group].ready)
        if (frame) out.push_back(*std::exchange(frame, std::nullopt));
    return out;
  }

  /// Eyes whose other one did not come.
  std::uint64_t unmatched() const {
    const std::scoped_lock lock(mutex_);
    return unmatched_;
  }

 private:
  using EyeFrames = std::array<std::optional<capture::Frame>, 2>;
  struct EyeOfGroup {
    std::size_t group = 0, eye = 0;
  };
  struct Group {
    int eyes = 1;
    EyeFrames ready, arriving;
    std::array<std::optional<TimestampNs>, 2> last;  // of each eye
  };
  static constexpr Seconds kGone{.25};  // an eye that brings nothing for so long

  static bool holds(const EyeFrames& pair) { return pair[0] || pair[1]; }

  // Whose frame is the oldest; beyond the last without any.
  std::size_t next() const {
    std::size_t out = groups_.size();
    const auto time = [](const Group& g) { return (g.ready[0] ? g.ready[0] : g.ready[1])->time; };
    for (std::size_t i = 0; i < groups_.size(); ++i)
      if (holds(groups_[i].ready) &&
          (out == groups_.size() || time(groups_[i]) < time(groups_[out])))
        out = i;
    return out;
  }

  void hand_on(Group& group, EyeFrames pair) {
    for (const auto& frame : group.ready) dropped_ += frame.has_value();
    group.ready = std::move(pair);
    group.arriving = {};
  }

  void match(Group& group, std::size_t eye, capture::Frame frame) {
    const TimestampNs time = frame.time;
    // Gone while this eye came: where both paused, the other one is on its way.
    const auto before = std::exchange(group.last[eye], time);
    unmatched_ += group.arriving[eye].has_value();
    group.arriving[eye] = std::move(frame);
    auto& other = group.arriving[1 - eye];
    if (other) {
      const Seconds apart = time - other->time;
      if (std::abs(apart.count()) < tolerance_.count())
        return hand_on(group, std::move(group.arriving));
      ++unmatched_;
      if (apart.count() > 0)
        other.reset();
      else
        return group.arriving[eye].reset();
    }
    if (!first_) first_ = time;
    if (before && *before - group.last[1 - eye].value_or(*first_) > kGone) {
      ++unmatched_;
      hand_on(group, std::move(group.arriving));
    }
  }

  const Seconds tolerance_;
  std::vector<EyeOfGroup> group_of_;  // by camera
  std::vector<Group> groups_;         // guarded by mutex_, as is all below
  std::optional<TimestampNs> first_;
  std::uint64_t unmatched_ = 0;
};

}  // namespace penumbra::runtime
