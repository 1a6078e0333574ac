#include "service/head_poses.h"

namespace penumbra::service {

// How sure a pose is no runtime tells; these are the figures of a good inside-out tracker.
std::optional<capture::FramePose> HeadPoses::pose_of(const capture::Frame& frame) {
  constexpr double kSigma_m = .001, kSigma_rad = .002;
  constexpr double kSigmaUntracked_m = .1;  // of a sitting person's head
  const auto head = headset_->head_at(frame.time);
  const std::scoped_lock lock(mutex_);
  asked_ = frame.time;
  if (head && head->position_tracked) place_tracked_ = true;
  // A headset that was put away, or another one, has its time to find its place again.
  if (!head || !head->rotation_tracked) untracked_since_.reset(), turns_alone_ = false;
  if (const std::string name = headset_->state().headset; name != name_)
    name_ = name, place_tracked_ = head && head->position_tracked;
  // What the runtime makes up while it does not see would let objects drift.
  if (!head || !head->rotation_tracked ||
      (!head->position_tracked && !follows_turns_alone(frame.time))) {
    ++missed_;
    return std::nullopt;
  }
  ++taken_;
  last_ = frame.time;
  return capture::FramePose{head->world_from_device,
                            head->position_tracked ? kSigma_m : kSigmaUntracked_m, kSigma_rad,
                            Seconds(0)};
}

bool HeadPoses::follows_turns_alone(TimestampNs time) {
  constexpr Seconds kPatience(2);  // in which a tracker finds its place
  if (place_tracked_) return false;
  if (!untracked_since_) untracked_since_ = time;
  return turns_alone_ = time - *untracked_since_ >= kPatience;
}

capture::PoseSourceState HeadPoses::state() const {
  const HeadsetState headset = headset_->state();
  const std::scoped_lock lock(mutex_);
  capture::PoseSourceState out;
  out.name = "openxr: the head of " + (headset.headset.empty() ? "no headset" : headset.headset);
  if (last_ && asked_) out.age = *asked_ - *last_;
  out.taken = taken_;
  out.refused = missed_;
  out.trouble = headset.trouble;
  if (out.trouble.empty() && turns_alone_ && !place_tracked_)
    out.trouble = "the headset does not track where it is, only how it is turned";
  return out;
}

}  // namespace penumbra::service
