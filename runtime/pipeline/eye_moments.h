// Which frames of a stereo pair belong together, where frames come in order of time.
// threads: thread-bound
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include "capture/frames.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

/// Both eyes of a pair have the number of their moment; every other camera counts its own frames.
class EyeMoments {
 public:
  /// period: between two frames of a camera; eyes less than half of it apart belong together. 0:
  /// unknown, a thirtieth of a second
  EyeMoments(const std::vector<capture::CameraInfo>& cameras, Seconds period)
      : tolerance_(period.count() > 0 ? period / 2 : Seconds(1. / 60)), counts_(cameras.size()) {
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      if (cameras[i].role != capture::Role::kView) continue;
      for (std::size_t eye = 0; eye < kNames.size(); ++eye)
        if (cameras[i].eye == kNames[eye] && !eyes_[eye]) eyes_[eye] = static_cast<int>(i);
    }
  }
  bool paired() const { return eyes_[0] && eyes_[1]; }

  /// Of a frame that comes next, from 0.
  std::uint64_t number(const capture::Frame& frame) {
    const bool is_eye = frame.camera == eyes_[0] || frame.camera == eyes_[1];
    if (!paired() || !is_eye) return counts_[static_cast<std::size_t>(frame.camera)]++;
    const std::size_t eye = frame.camera == eyes_[0] ? 0 : 1;
    const bool joins =
        moment_ && !has_[eye] && std::abs((frame.time - *moment_).count()) < tolerance_.count();
    if (!joins) {
      unmatched_ += moment_ && !(has_[0] && has_[1]);
      moments_ += moment_.has_value();
      moment_ = frame.time;
      has_ = {};
    }
    has_[eye] = true;
    return moments_;
  }

  /// Eyes whose other one did not come, so far.
  std::uint64_t unmatched() const { return unmatched_ + (moment_ && !(has_[0] && has_[1])); }

 private:
  static constexpr std::array<std::string_view, 2> kNames{"left", "right"};

  Seconds tolerance_;
  std::vector<std::uint64_t> counts_;  // by camera
  std::array<std::optional<int>, 2> eyes_;
  std::optional<TimestampNs> moment_;
  std::array<bool, 2> has_{};
  std::uint64_t moments_ = 0, unmatched_ = 0;
};

}  // namespace penumbra::runtime
#pragma GCC visibility pop
