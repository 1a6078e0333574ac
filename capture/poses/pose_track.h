// A recorded track of a body as a table, and as the source of a capture's poses.
// threads: reentrant; PoseTrack as PoseSource
#pragma once

#include <filesystem>
#include <memory>
#include <mutex>
#include <vector>

#include "capture/poses/pose_source.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// CSV with the header time_ns,tx,ty,tz,qx,qy,qz,qw (whole nanoseconds) or
/// time_s,tx,ty,tz,qx,qy,qz,qw: metres, a unit quaternion, times that rise.
/// errors: kNotFound, kUnreadable, kInvalid (file and line)
Result<std::vector<TimedPose>> read_pose_track(const std::filesystem::path& path);

class PoseTrack : public PoseSource {
 public:
  /// clock_offset:      added to the track's times
  /// max_extrapolation: one period of the frames
  /// errors: as read_pose_track(); kInvalid (no pose that follows another plausibly)
  static Result<std::unique_ptr<PoseTrack>> open(const std::filesystem::path& path,
                                                 Seconds clock_offset = Seconds(0),
                                                 Seconds max_extrapolation = Seconds(1 / 30.));
  std::optional<FramePose> pose_of(const Frame& frame) override;
  PoseSourceState state() const override;

 private:
  explicit PoseTrack(PoseHistoryOptions options) : history_(std::move(options)) {}
  PoseHistory history_;  // never changed after open()
  mutable std::mutex mutex_;
  PoseSourceState state_;  // guarded by mutex_
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
