// Where the poses of frames come from: a board, a track, a stream, a headset.
// threads: pose_of() thread-bound, state() thread-safe
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "capture/frames.h"
#include "capture/poses/pose_history.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// For people and programs that watch the service.
struct PoseSourceState {
  std::string name;            // what it is and where it comes from
  std::optional<Seconds> age;  // of the newest pose, at the frame that was last asked for
  std::uint64_t taken = 0, refused = 0;
  std::string trouble;  // why the poses may be wrong or missing; empty while all is well
};

class PoseSource {
 public:
  virtual ~PoseSource() = default;
  /// The body's pose at the frame's time, on the source's clock; nothing where it is not known.
  virtual std::optional<FramePose> pose_of(const Frame& frame) = 0;
  virtual PoseSourceState state() const = 0;
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
