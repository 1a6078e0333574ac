#include "capture/poses/pose_history.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <utility>

#include "core/io/log.h"

namespace penumbra::capture {

namespace {

constexpr Seconds kLate{1};                      // that a pose may come behind newer ones
constexpr double kHand_m = 3, kHand_rad = 15;    // accelerations that poses do not tell
constexpr double kDrift_m = .5, kDrift_rad = 1;  // velocities of a body seen once
constexpr double kPlausibleSigmas = 3;

bool all_finite(const TimedPose& p) {
  const glm::dquat& q = p.world_from_body.rotation;
  const glm::dvec3& t = p.world_from_body.translation;
  for (const double v : {q.w, q.x, q.y, q.z, t.x, t.y, t.z, p.sigma_m, p.sigma_rad})
    if (!std::isfinite(v)) return false;
  return true;
}

// The turn from one rotation to another in the world's axes, the short way; radians.
glm::dvec3 turn_between(const glm::dquat& from, const glm::dquat& to) {
  glm::dquat d = to * glm::conjugate(from);
  if (d.w < 0) d = -d;
  const glm::dvec3 axis(d.x, d.y, d.z);
  const double sine = glm::length(axis);
  if (sine < 1e-12) return 2. * axis;
  return axis * (2 * std::atan2(sine, d.w) / sine);
}

glm::dquat turned(const glm::dquat& rotation, const glm::dvec3& turn) {
  const double angle = glm::length(turn);
  if (angle < 1e-12) return rotation;
  return glm::normalize(glm::angleAxis(angle, turn / angle) * rotation);
}

double square(double x) {
  return x * x;
}

}  // namespace

double PoseHistory::jump_ratio(const TimedPose& a, const TimedPose& b) const {
  const double seconds = std::abs((b.time - a.time).count());
  const Pose &p = a.world_from_body, &q = b.world_from_body;
  const double way = glm::length(q.translation - p.translation),
               turn = glm::length(turn_between(p.rotation, q.rotation));
  constexpr double kLeast = 1e-9;
  return std::max(way / (options_.max_speed_m * seconds +
                         kPlausibleSigmas * std::hypot(a.sigma_m, b.sigma_m) + kLeast),
                  turn / (options_.max_turn_rad * seconds +
                          kPlausibleSigmas * std::hypot(a.sigma_rad, b.sigma_rad) + kLeast));
}

std::unexpected<Error> PoseHistory::refuse(ErrorCode code, std::string why) {
  ++refused_;
  return fail(code, options_.name, std::move(why));
}

Result<void> PoseHistory::put(TimedPose pose) {
  if (!all_finite(pose)) return refuse(ErrorCode::kNonFinite, "a pose is not finite");
  if (std::abs(glm::length(pose.world_from_body.rotation) - 1) > kQuaternionSlack)
    return refuse(ErrorCode::kInvalid, "a quaternion is not of unit length");
  if (pose.sigma_m < 0 || pose.sigma_rad < 0)
    return refuse(ErrorCode::kInvalid, "a standard deviation is below 0");
  if (pose.time.value > kLargestPoseTime_ns || pose.time.value < -kLargestPoseTime_ns)
    return refuse(ErrorCode::kInvalid, "a time is beyond any clock");
  pose.world_from_body.rotation = glm::normalize(pose.world_from_body.rotation);
  if (!poses_.empty() && poses_.back().time - pose.time > kLate) return put_of_the_past(pose);
  past_.reset();
  if (poses_.empty()) {
    append(pose);
    return {};
  }
  return pose.time > poses_.back().time ? put_newest(pose) : put_between(pose);
}

Result<void> PoseHistory::put_newest(const TimedPose& pose) {
  const double from_last = jump_ratio(poses_.back(), pose);
  if (const auto held = std::exchange(held_, std::nullopt)) {
    const double from_held = pose.time > held->time ? jump_ratio(*held, pose) : from_last + 1;
    if (from_held <= 1 && from_held < from_last) {
      append(*held);
      append(pose);
      return {};
    }
    ++refused_;
  }
  if (from_last <= 1)
    append(pose);
  else
    held_ = pose;
  return {};
}

Result<void> PoseHistory::put_between(const TimedPose& pose) {
  const auto after = std::ranges::lower_bound(poses_, pose.time, {}, &TimedPose::time);
  const auto before = after == poses_.begin() ? after : std::prev(after);
  const bool nearer_before = pose.time - before->time < after->time - pose.time;
  if (jump_ratio(nearer_before ? *before : *after, pose) > 1)
    return refuse(ErrorCode::kInvalid, "a late pose jumps from those around it");
  ++taken_;
  if (after->time == pose.time)
    *after = pose;
  else
    poses_.insert(after, pose);
  if (poses_.size() > options_.capacity) poses_.pop_front();
  return {};
}

Result<void> PoseHistory::put_of_the_past(const TimedPose& pose) {
  const Seconds back = poses_.back().time - pose.time;
  const bool confirmed = past_ && pose.time > past_->time && pose.time - past_->time <= kLate;
  if (!confirmed) {
    past_ = pose;
    return refuse(ErrorCode::kInvalid,
                  fmt::format("a pose is {:.1f} s older than the newest", back.count()));
  }
  if (restarts_++ == 0)
    log_warning("{}: the sender's clock went back by {:.1f} s: its poses are taken anew",
                options_.name, back.count());
  poses_.clear();
  held_.reset();
  append(*std::exchange(past_, std::nullopt));
  return put_newest(pose);
}

void PoseHistory::append(const TimedPose& pose) {
  ++taken_;
  poses_.push_back(pose);
  if (poses_.size() > options_.capacity) poses_.pop_front();
}

std::optional<TimestampNs> PoseHistory::newest() const {
  if (poses_.empty()) return std::nullopt;
  return poses_.back().time;
}

std::optional<FramePose> PoseHistory::at(TimestampNs time) const {
  const auto after = std::ranges::upper_bound(poses_, time, {}, &TimedPose::time);
  if (after == poses_.begin()) return std::nullopt;
  const auto before = std::prev(after);
  if (before->time == time)
    return FramePose{before->world_from_body, before->sigma_m, before->sigma_rad, Seconds(0)};
  if (after != poses_.end() && after->time - before->time <= options_.max_gap)
    return between(*before, *after, time);
  // Half a nanosecond's rounding of a period is no reason to lose a frame.
  if (time - before->time > options_.max_extrapolation + Seconds(1e-6)) return std::nullopt;
  return beyond(static_cast<std::size_t>(before - poses_.begin()), time);
}

FramePose PoseHistory::between(const TimedPose& a, const TimedPose& b, TimestampNs time) const {
  const double dt = (b.time - a.time).count(), u = (time - a.time).count() / dt;
  if (jump_ratio(a, b) > 1) {
    const TimedPose& nearer = u < .5 ? a : b;
    return {nearer.world_from_body, nearer.sigma_m, nearer.sigma_rad, Seconds(0)};
  }
  const Pose &p = a.world_from_body, &q = b.world_from_body;
  const double bow = u * (1 - u) * dt * dt / 2;
  const auto sigma = [&](double s0, double s1, double acceleration) {
    return std::sqrt(square((1 - u) * s0) + square(u * s1) + square(acceleration * bow));
  };
  return {{turned(p.rotation, u * turn_between(p.rotation, q.rotation)),
           (1 - u) * p.translation + u * q.translation},
          sigma(a.sigma_m, b.sigma_m, kHand_m),
          sigma(a.sigma_rad, b.sigma_rad, kHand_rad),
          Seconds(0)};
}

FramePose PoseHistory::beyond(std::size_t last, TimestampNs time) const {
  const TimedPose& end = poses_[last];
  const Pose& q = end.world_from_body;
  const double e = (time - end.time).count();
  std::size_t first = last;  // of the poses that tell the velocity
  while (first > 0 && end.time - poses_[first].time < options_.max_extrapolation &&
         poses_[first].time - poses_[first - 1].time <= options_.max_gap &&
         jump_ratio(poses_[first - 1], poses_[first]) <= 1)
    --first;
  if (first == last)
    return {q, std::hypot(end.sigma_m, kDrift_m * e), std::hypot(end.sigma_rad, kDrift_rad * e),
            Seconds(e)};
  const TimedPose& start = poses_[first];
  const Pose& p = start.world_from_body;
  const double r = e / (end.time - start.time).count();
  const auto sigma = [&](double s0, double s1, double acceleration) {
    return std::sqrt(square((1 + r) * s1) + square(r * s0) + square(acceleration * e * e / 2));
  };
  return {{turned(q.rotation, r * turn_between(p.rotation, q.rotation)),
           q.translation + r * (q.translation - p.translation)},
          sigma(start.sigma_m, end.sigma_m, kHand_m),
          sigma(start.sigma_rad, end.sigma_rad, kHand_rad),
          Seconds(e)};
}

}  // namespace penumbra::capture
