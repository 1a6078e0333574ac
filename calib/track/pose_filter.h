// A tracked pose without its jitter, and without lag.
// source: Kalman 1960; constant velocity with white acceleration, Bar-Shalom, Li & Kirubarajan 2001
// threads: thread-bound
#pragma once

#include <memory>
#include <optional>

#include "calib/track/board_tracker.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// Pose and velocity, twelve numbers, with the measurements' own covariances. Constant motion is
/// followed without a mean error whatever the gains are; the acceleration that is allowed grows
/// as soon as the innovations exceed what it explains, and falls by one step of ten a picture.
class PoseFilter {
 public:
  PoseFilter();
  PoseFilter(PoseFilter&&) noexcept;
  PoseFilter& operator=(PoseFilter&&) noexcept;
  ~PoseFilter();

  /// The best pose at the measurement's time, with its covariance; the rest is the measurement's.
  /// A measurement that no acceleration explains is held back once: the next one, or one that
  /// follows after half a second, begins anew.
  TrackedPose update(const TrackedPose& measured);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace penumbra::calib
#pragma GCC visibility pop
