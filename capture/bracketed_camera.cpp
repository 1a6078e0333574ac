#include "capture/bracketed_camera.h"

#include <utility>

namespace penumbra::capture {

Result<void> BracketedCamera::connect(std::unique_ptr<CameraDevice> device) {
  device_ = std::move(device);
  // A new device counts from the start and follows as late as the old one did.
  labels_ = ExposureLabels(labels_.delay() && counts_.frames > 0 ? labels_.delay() : delay_);
  counter_ = {};
  lost_before_ = counts_.lost;
  frame_ = 0;
  if (schedule_.empty()) return {};
  return ask();
}

Result<void> BracketedCamera::ask() {
  const Exposure wanted = device_->nearest(schedule_[next_++ % schedule_.size()]);
  PENUMBRA_TRY(device_->request(wanted));
  labels_.requested(frame_, wanted);
  return {};
}

Result<std::optional<Frame>> BracketedCamera::next(Seconds timeout) {
  auto came = device_->wait(timeout);
  if (!came) {
    device_.reset();
    return std::unexpected(came.error());
  }
  if (!*came) return std::nullopt;
  CameraFrame& raw = **came;
  if (raw.damaged) {
    ++counts_.damaged;
    return std::nullopt;
  }
  frame_ = counter_.count(raw.sequence, raw.time);
  counts_.lost = lost_before_ + counter_.lost();
  ExposureLabels::Label label{ExposureLabels::Verdict::kGood, {}};
  if (raw.applied) {
    label.exposure = *raw.applied;
  } else if (schedule_.size() == 1) {
    label.exposure = device_->nearest(schedule_[0]);
  } else if (!schedule_.empty()) {
    label = labels_.judge(frame_, raw.time, meter_.measure(raw.pixels));
    counts_.delay_frames = labels_.delay();
    counts_.deaf = labels_.deaf();
  }
  if (schedule_.size() > 1) PENUMBRA_TRY(ask());
  if (label.verdict == ExposureLabels::Verdict::kRefused) ++counts_.refused;
  if (label.verdict != ExposureLabels::Verdict::kGood) return std::nullopt;
  ++counts_.frames;
  return Frame{0,
               sent_++,
               raw.time,
               label.exposure,
               info_.world_from_camera,
               std::make_shared<const FramePixels>(std::move(raw.pixels))};
}

}  // namespace penumbra::capture
