#include "service/head_poses.h"

#include <fmt/format.h>

namespace penumbra::service {

namespace {

constexpr Seconds kPatience(2);  // in which a tracker finds its place

}  // namespace

// How sure a pose is no runtime tells; these are the figures of a good inside-out tracker.
std::optional<capture::FramePose> HeadPoses::pose_of(const capture::Frame& frame) {
  constexpr double kSigma_m = .001, kSigma_rad = .002;
  constexpr double kSigmaUntracked_m = .1;  // of a sitting person's head
  const auto head =
      hand_ ? headset_->controller_at(*hand_, frame.time) : headset_->head_at(frame.time);
  const std::scoped_lock lock(mutex_);
  asked_ = frame.time;
  if (head && head->position_tracked) place_tracked_ = true;
  const bool follows = head && head->rotation_tracked;
  if (follows)
    gone_since_.reset();
  else if (!gone_since_)
    gone_since_ = frame.time;
  // A headset that was put away, or another one, has its time to find its place again. One that a
  // busy machine heard nothing of for some frames has not.
  if (gone_since_ && frame.time - *gone_since_ >= kPatience) start_anew();
  if (const std::string name = headset_->state().headset; name != name_) {
    name_ = name, place_tracked_ = head && head->position_tracked;
    start_anew();
  }
  // What the runtime makes up while it does not see would let objects drift.
  if (!follows || (!head->position_tracked && !follows_turns_alone(frame.time))) {
    ++missed_;
    const std::string_view device = device_name();
    if (!head)
      missing_ =
          fmt::format("the runtime tells no pose of the {} for the time of the picture", device);
    else if (!follows)
      missing_ = fmt::format("it is not tracked how the {} is turned", device);
    else if (place_tracked_)
      missing_ = fmt::format("the {} has lost its place", device);
    else
      missing_ = fmt::format("it is not tracked where the {} is: waits whether it finds its place",
                             device);
    return std::nullopt;
  }
  ++taken_;
  missing_.clear();
  last_ = frame.time;
  return capture::FramePose{head->world_from_device,
                            head->position_tracked ? kSigma_m : kSigmaUntracked_m, kSigma_rad,
                            Seconds(0)};
}

void HeadPoses::start_anew() {
  untracked_since_.reset();
  turns_alone_ = false;
}

std::string_view HeadPoses::device_name() const {
  if (!hand_) return "head";
  return *hand_ == Hand::kLeft ? "left controller" : "right controller";
}

bool HeadPoses::follows_turns_alone(TimestampNs time) {
  if (place_tracked_ || hand_) return false;
  if (!untracked_since_) untracked_since_ = time;
  return turns_alone_ = time - *untracked_since_ >= kPatience;
}

capture::PoseSourceState HeadPoses::state() const {
  const HeadsetState headset = headset_->state();
  const std::scoped_lock lock(mutex_);
  capture::PoseSourceState out;
  out.name = fmt::format("openxr: the {} of {}", device_name(),
                         headset.headset.empty() ? "no headset" : headset.headset);
  if (last_ && asked_) out.age = *asked_ - *last_;
  out.taken = taken_;
  out.refused = missed_;
  out.trouble = headset.trouble;
  if (out.trouble.empty() && turns_alone_ && !place_tracked_)
    out.trouble = "the headset does not track where it is, only how it is turned";
  if (headset.trouble.empty() && !missing_.empty()) out.trouble = missing_;
  return out;
}

}  // namespace penumbra::service
