#include "capture/bracketed_camera.h"

#include <utility>

namespace penumbra::capture {

Result<void> BracketedCamera::connect(std::unique_ptr<CameraDevice> device) {
  device_ = std::move(device);
  // A new device counts from the start and follows as late as the old one did.
  labels_ = ExposureLabels(labels_.delay() && counts_.frames > 0 ? labels_.delay() : delay_);
  counter_ = {};
  lost_before_ = counts_.lost;
  if (schedule_.empty()) return {};
  return ask();
}

Result<void> BracketedCamera::ask() {
  const Exposure wanted = device_->nearest(schedule_[next_++ % schedule_.size()]);
  PENUMBRA_TRY(device_->request(wanted));
  labels_.requested(counter_.at(device_->now()), wanted);
  return {};
}

Result<std::optional<Frame>> BracketedCamera::next(Seconds timeout) {
  // When a request takes effect is certain only where it is made soon after a frame arrived.
  auto came = device_->wait(timeout, counter_.fresh());
  if (!came) {
    device_.reset();
    return std::unexpected(came.error());
  }
  if (!*came) return std::nullopt;
  const CameraFrame& raw = **came;
  const std::uint64_t number = counter_.count(raw.sequence, raw.time, device_->now());
  if (schedule_.size() > 1) PENUMBRA_TRY(ask());
  auto pixels = device_->pixels();
  counts_.damaged += static_cast<std::uint64_t>(raw.damaged_before) + !pixels;
  counts_.lost = lost_before_ + counter_.lost();
  if (!pixels) return std::nullopt;
  ++counts_.arrived;
  const ExposureLabels::Label label = label_of(raw.time, number, *pixels);
  if (label.verdict == ExposureLabels::Verdict::kRefused) ++counts_.refused;
  if (label.verdict != ExposureLabels::Verdict::kGood) return std::nullopt;
  ++counts_.frames;
  return Frame{0,
               sent_++,
               raw.time,
               label.exposure,
               info_.world_from_camera,
               std::make_shared<const FramePixels>(std::move(*pixels)),
               device_->jpeg()};
}

ExposureLabels::Label BracketedCamera::label_of(TimestampNs time, std::uint64_t number,
                                                const FramePixels& pixels) {
  using enum ExposureLabels::Verdict;
  if (schedule_.empty()) return {kGood, {Seconds(1), Gain(1)}};
  if (schedule_.size() == 1) return {kGood, device_->nearest(schedule_[0])};
  const auto label = labels_.judge(number, time, meter_.measure(pixels));
  counts_.delay_frames = labels_.delay();
  counts_.deaf = labels_.deaf();
  return label;
}

}  // namespace penumbra::capture
