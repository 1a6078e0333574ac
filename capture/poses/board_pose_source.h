// Poses from boards that a view camera sees. The body is that camera.
// threads: pose_of() thread-bound, state() thread-safe
#pragma once

#include <memory>
#include <mutex>

#include "calib/track/board_tracker.h"
#include "calib/track/pose_filter.h"
#include "capture/poses/pose_source.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

struct BoardPoseOptions {
  int camera = 0;  // whose frames are searched, index into FrameSource::cameras()
  bool filtered = true;
  Seconds max_extrapolation{1 / 30.};  // one period of the frames
};

/// Frames of other cameras, and darker ones, get what the history of that camera's poses says of
/// their time.
class BoardPoseSource : public PoseSource {
 public:
  /// errors: as BoardTracker::create()
  static Result<std::unique_ptr<BoardPoseSource>> create(std::vector<calib::PlacedBoard> boards,
                                                         const calib::CameraModel& lens,
                                                         const BoardPoseOptions& options);
  std::optional<FramePose> pose_of(const Frame& frame) override;
  PoseSourceState state() const override;

 private:
  BoardPoseSource(calib::BoardTracker tracker, const BoardPoseOptions& options);
  const BoardPoseOptions options_;
  calib::BoardTracker tracker_;
  calib::PoseFilter filter_;
  PoseHistory history_;
  mutable std::mutex mutex_;
  PoseSourceState state_;  // guarded by mutex_
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
