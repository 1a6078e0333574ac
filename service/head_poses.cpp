#include "service/head_poses.h"

namespace penumbra::service {

// How sure a pose is no runtime tells; these are the figures of a good inside-out tracker.
std::optional<capture::FramePose> HeadPoses::pose_of(const capture::Frame& frame) {
  constexpr double kSigma_m = .001, kSigma_rad = .002;
  const auto head = headset_->head_at(frame.time);
  const std::scoped_lock lock(mutex_);
  asked_ = frame.time;
  // What the runtime makes up while it does not see would let objects drift.
  if (!head || !head->position_tracked || !head->rotation_tracked) {
    ++missed_;
    return std::nullopt;
  }
  ++taken_;
  last_ = frame.time;
  return capture::FramePose{head->world_from_device, kSigma_m, kSigma_rad, Seconds(0)};
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
  return out;
}

}  // namespace penumbra::service
