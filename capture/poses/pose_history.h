// Poses of a moving body by their times, and what they say of the moment of a frame.
// threads: thread-bound
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>

#include "core/pose.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// Standard deviations of a pose whose sender tells none.
inline constexpr double kUsualPoseSigma_m = .002, kUsualPoseSigma_rad = .002;
/// What a quaternion's length may be off by.
inline constexpr double kQuaternionSlack = 1e-2;
/// Times beyond this are no times of any clock.
inline constexpr std::int64_t kLargestPoseTime_ns = 4'000'000'000'000'000'000;

struct TimedPose {
  TimestampNs time;
  Pose world_from_body;
  double sigma_m = kUsualPoseSigma_m, sigma_rad = kUsualPoseSigma_rad;  // one standard deviation
};

/// What is known of the body at the moment of a frame.
struct FramePose {
  Pose pose;  // world_from_body
  double sigma_m = 0, sigma_rad = 0;
  Seconds extrapolated{0};  // beyond the newest pose; 0 between two of them
};

struct PoseHistoryOptions {
  std::string name = "poses";          // in messages
  std::size_t capacity = 1024;         // poses that are kept, the newest
  Seconds max_gap{.25};                // between neighbours that are interpolated
  Seconds max_extrapolation{1 / 30.};  // one period of the frames
  double max_speed_m = 5;              // a second; what is faster is a jump
  double max_turn_rad = 20;            // a second
};

/// Bounded and in order of time. Jumps and clocks that go back need a second witness.
class PoseHistory {
 public:
  explicit PoseHistory(PoseHistoryOptions options = {}) : options_(std::move(options)) {}

  /// A pose out of order within the last second is sorted in; one of a time that is there replaces
  /// it. A pose that no plausible velocity explains is held back until the next one confirms it.
  /// A pose more than a second older than the newest is refused; a second one beside it says that
  /// the sender began anew, and the history starts with those two.
  /// errors: kNonFinite, kInvalid (the quaternion is not of unit length within 1 %, a standard
  ///         deviation below 0, a time that no clock has, too late, a jump backwards in order)
  Result<void> put(TimedPose pose);

  /// Between two poses: position linear, rotation along the great arc, with
  ///   sigma^2 = (1-u)^2 s0^2 + u^2 s1^2 + (a u (1-u) dt^2 / 2)^2.
  /// After the newest, or into a gap: by the mean velocity of the last `max_extrapolation` at
  /// least, for at most that long, with r = e/dt and
  ///   sigma^2 = (1+r)^2 s1^2 + r^2 s0^2 + (a e^2 / 2)^2,
  /// where e is the time beyond the last pose, dt the time between the two that tell the velocity,
  /// and a = 3 m/s^2 or 15 rad/s^2 of a hand. Without a velocity the pose is held, with
  ///   sigma^2 = s1^2 + (v e)^2 for v = 0.5 m/s or 1 rad/s.
  /// Beside a jump: the nearer of the two poses.
  /// out: nothing before the first pose and where the poses are stale
  std::optional<FramePose> at(TimestampNs time) const;

  /// Time of the newest pose.
  std::optional<TimestampNs> newest() const;
  std::size_t size() const { return poses_.size(); }
  std::uint64_t taken() const { return taken_; }
  /// Poses that put() refused or that nothing confirmed.
  std::uint64_t refused() const { return refused_; }
  /// Times that the sender began anew.
  std::uint64_t restarts() const { return restarts_; }

 private:
  // How far apart two poses are, over the farthest that is plausible; above 1: a jump.
  double jump_ratio(const TimedPose& a, const TimedPose& b) const;
  Result<void> put_newest(const TimedPose& pose);
  Result<void> put_between(const TimedPose& pose);
  Result<void> put_of_the_past(const TimedPose& pose);
  void append(const TimedPose& pose);
  std::unexpected<Error> refuse(ErrorCode code, std::string why);
  FramePose between(const TimedPose& a, const TimedPose& b, TimestampNs time) const;
  FramePose beyond(std::size_t last, TimestampNs time) const;

  PoseHistoryOptions options_;
  std::deque<TimedPose> poses_;    // by time, no two alike
  std::optional<TimedPose> held_;  // a jump without a witness
  std::optional<TimedPose> past_;  // of a clock that may have begun anew
  std::uint64_t taken_ = 0, refused_ = 0, restarts_ = 0;
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
