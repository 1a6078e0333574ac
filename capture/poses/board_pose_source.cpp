#include "capture/poses/board_pose_source.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace penumbra::capture {

namespace {

// The tracker and its filter have seen to jumps.
PoseHistoryOptions history_options(const BoardPoseOptions& o) {
  constexpr double kAny = 1e6;
  return {.name = "board",
          .capacity = 256,
          .max_extrapolation = o.max_extrapolation,
          .max_speed_m = kAny,
          .max_turn_rad = kAny};
}

// Root of the mean of three variances.
double sigma_of(const std::array<double, 36>& covariance, std::size_t first) {
  double sum = 0;
  for (std::size_t i = first; i < first + 3; ++i) sum += covariance[7 * i];
  return std::sqrt(std::max(0., sum / 3));
}

}  // namespace

BoardPoseSource::BoardPoseSource(calib::BoardTracker tracker, const BoardPoseOptions& options)
    : options_(options), tracker_(std::move(tracker)), history_(history_options(options)) {
  state_.name = "board";
  state_.trouble = "no board has been seen";
}

Result<std::unique_ptr<BoardPoseSource>> BoardPoseSource::create(
    std::vector<calib::PlacedBoard> boards, const calib::CameraModel& lens,
    const BoardPoseOptions& options) {
  PENUMBRA_ASSIGN(tracker, calib::BoardTracker::create(std::move(boards), lens));
  return std::unique_ptr<BoardPoseSource>(new BoardPoseSource(std::move(tracker), options));
}

std::optional<FramePose> BoardPoseSource::pose_of(const Frame& frame) {
  const bool looks = frame.camera == options_.camera && !frame.for_light && frame.pixels;
  bool found = true;
  if (looks) {
    auto pose = tracker_.track(*frame.pixels, frame.time);
    found = pose.has_value();
    if (pose && options_.filtered) pose = filter_.update(*pose);
    // A frame that the history refuses counts there.
    if (pose)
      (void)history_.put({frame.time, pose->world_from_camera, sigma_of(pose->covariance, 3),
                          sigma_of(pose->covariance, 0)});
  }
  const auto newest = history_.newest();
  const std::scoped_lock lock(mutex_);
  state_.taken = history_.taken();
  state_.refused = history_.refused() + tracker_.counts().undecided;
  if (newest) state_.age = std::max(Seconds(0), frame.time - *newest);
  if (looks) {
    state_.trouble = tracker_.trouble();
    if (!found && state_.trouble.empty()) state_.trouble = "no board is seen";
  }
  return history_.at(frame.time);
}

PoseSourceState BoardPoseSource::state() const {
  const std::scoped_lock lock(mutex_);
  return state_;
}

}  // namespace penumbra::capture
