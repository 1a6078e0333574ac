#include "capture/device/internal/bracketed_camera.h"

#include <algorithm>
#include <utility>

namespace penumbra::capture {

Result<void> BracketedCamera::connect(std::unique_ptr<CameraDevice> device) {
  device_ = std::move(device);
  // It follows as late as the one before it.
  begin_labels(labels_.delay() && counts_.frames > 0 ? labels_.delay() : delay_);
  counter_ = {};
  next_frame_.reset();
  settled_ = 0;
  lost_before_ = counts_.lost;
  if (auto_schedule_ && schedule_.empty()) take(auto_schedule_->probe(limits()));
  if (schedule_.empty()) return {};
  return ask();
}

void BracketedCamera::set_exposures(const std::vector<Exposure>& exposures) {
  if (!sets_exposures()) return;
  auto_schedule_.reset();
  if (exposures.empty() && light_error_) auto_schedule_.emplace(info_, *light_error_);
  schedule_ = exposures.empty() ? configured_ : exposures;
  next_ = 0;
  counts_.light_error.reset();
  // A delay that was measured may be off by a turn of the exposures before.
  begin_labels(delay_);
  if (!device_) return;  // asked for once it is back
  take(auto_schedule_ ? auto_schedule_->probe(limits()) : schedule_);
  settled_ = counter_.at(device_->now()) + 1 +
             static_cast<std::uint64_t>(delay_.value_or(ExposureLabels::kMaxDelay));
  back_to_usual_ = !ask();  // what a device refuses is asked again
}

// Nothing that was asked before counts.
void BracketedCamera::begin_labels(std::optional<int> delay) {
  labels_ = ExposureLabels(delay);
  reports_exposures_ = back_to_usual_ = false;
  darker_exposure_.reset(), darker_.reset();
  missed_ = 0, darkens_ = true;
}

// What the device makes of a plan: times in its steps, each once.
void BracketedCamera::take(std::vector<Exposure> planned) {
  for (Exposure& e : planned) e = device_->nearest(e);
  const auto same = [](const Exposure& a, const Exposure& b) {
    return a.time == b.time && a.gain == b.gain;
  };
  const auto rest = std::ranges::unique(planned, same);
  planned.erase(rest.begin(), rest.end());
  std::erase_if(planned, [](const Exposure& e) { return !(e.product() > 0); });
  if (planned.empty()) return;
  schedule_ = planned;
  next_ = 0;
  if (auto_schedule_) auto_schedule_->use(std::move(planned));
}

// A device makes of an exposure beyond its range the nearest that it has.
ExposureLimits BracketedCamera::limits() const {
  constexpr double kOfAPeriod = .9, kHighGain = 16;  // beyond, noise grows with the signal
  const auto nearest = [&](double time, double gain) {
    return device_->nearest({Seconds(time), Gain(gain)});
  };
  ExposureLimits out;
  // A range that begins at nothing begins at the shortest time that anyone needs.
  out.shortest = std::max(out.shortest, nearest(out.shortest.count(), 1).time);
  out.longest = std::max(out.shortest, nearest(kOfAPeriod / fps_, 1).time);
  out.max_gain = std::max(Gain(1), nearest(out.longest.count(), kHighGain).gain);
  return out;
}

Result<void> BracketedCamera::ask() {
  const Exposure wanted = device_->nearest(schedule_[next_++ % schedule_.size()]);
  PENUMBRA_TRY(device_->request(wanted));
  if (!reports_exposures_) labels_.requested(counter_.at(device_->now()), wanted);
  return {};
}

void BracketedCamera::take_darker(double factor) {
  if (!can_take_darker() || !device_ || darker_) return;
  const Exposure& usual = schedule_[0];
  const Exposure wanted = device_->nearest({usual.time * factor, usual.gain});
  constexpr double kNotDarker = .7;
  darkens_ = wanted.product() < kNotDarker * usual.product();  // else it is at its shortest already
  if (!darkens_) return;
  darker_exposure_ = wanted;
  darker_factor_ = factor;
}

// For one frame: soon after a frame arrived, and back after the next. What a device refuses is
// asked again; whether it is gone wait() says.
void BracketedCamera::ask_for_darker() {
  const Exposure usual = device_->nearest(schedule_[0]);
  if (back_to_usual_) {
    back_to_usual_ = !device_->request(usual);
  } else if (darker_exposure_ && device_->request(*darker_exposure_)) {
    darker_.emplace(info_.response, *darker_exposure_, usual);
    darker_exposure_.reset();
    back_to_usual_ = true;
  }
}

std::optional<Frame> BracketedCamera::pass(Frame frame, const std::optional<Exposure>& applied) {
  if (!darker_) return frame;
  DarkerFrame::Passed passed = darker_->pass(std::move(frame), applied);
  if (darker_->over()) end_darker();
  if (!passed.darker) return std::move(passed.frame);
  next_frame_ = std::move(passed.frame);
  return std::move(passed.darker);
}

void BracketedCamera::end_darker() {
  constexpr double kFurther = 1. / 8, kDarkest = 1. / 512;
  constexpr int kMaxMissed = 3;
  const bool found = darker_->found(), white = darker_->is_white();
  darker_.reset();
  missed_ = found ? 0 : missed_ + 1;
  if (found) return;
  back_to_usual_ = true;  // in case that the device missed it
  if (white && darker_factor_ * kFurther >= kDarkest)
    take_darker(darker_factor_ * kFurther);
  else
    darkens_ = missed_ < kMaxMissed;
}

Result<std::optional<Frame>> BracketedCamera::next(Seconds timeout) {
  if (next_frame_) {
    ++counts_.frames;
    return std::exchange(next_frame_, std::nullopt);
  }
  // When a request takes effect is certain only where it is made soon after a frame arrived.
  auto came = device_->wait(timeout, counter_.fresh());
  if (!came) {
    device_.reset();
    return std::unexpected(came.error());
  }
  if (!*came) return std::nullopt;
  const CameraFrame& raw = **came;
  const std::uint64_t number = counter_.count(raw.sequence, raw.time, device_->now());
  if (asks_each_frame())
    PENUMBRA_TRY(ask());
  else if (!schedule_.empty())
    ask_for_darker();
  auto pixels = device_->pixels();
  counts_.damaged += static_cast<std::uint64_t>(raw.damaged_before) + !pixels;
  counts_.lost = lost_before_ + counter_.lost();
  if (!pixels) return std::nullopt;
  ++counts_.arrived;
  if (raw.applied) take_reported(number, *raw.applied);
  const ExposureLabels::Label label = label_of(raw.time, number, *pixels);
  if (label.verdict == ExposureLabels::Verdict::kRefused) ++counts_.rejected;
  if (label.verdict != ExposureLabels::Verdict::kGood) return std::nullopt;
  if (auto_schedule_ && auto_schedule_->see(*pixels, label.exposure, raw.time)) {
    take(auto_schedule_->plan().exposures);
  }
  counts_.exposures = schedule_;
  if (auto_schedule_) counts_.light_error = auto_schedule_->plan().error();
  auto frame = pass({0, sent_++, raw.time, label.exposure, info_.world_from_camera,
                     std::make_shared<const FramePixels>(std::move(*pixels)), device_->jpeg()},
                    raw.applied);
  counts_.frames += frame.has_value();
  return frame;
}

// A frame that tells its exposure needs no delay; what it tells is checked like any label.
void BracketedCamera::take_reported(std::uint64_t number, Exposure exposure) {
  if (!std::exchange(reports_exposures_, true)) labels_ = ExposureLabels(0);
  labels_.requested(number, exposure);
}

ExposureLabels::Label BracketedCamera::label_of(TimestampNs time, std::uint64_t number,
                                                const FramePixels& pixels) {
  using enum ExposureLabels::Verdict;
  if (schedule_.empty()) return {kGood, {Seconds(1), Gain(1)}};
  if (!asks_each_frame())
    return {number < settled_ ? kMeasuring : kGood, device_->nearest(schedule_[0])};
  const auto label = labels_.judge(number, time, meter_.measure(pixels));
  counts_.delay_frames = labels_.delay();
  counts_.ignores_controls = labels_.ignores_controls();
  return label;
}

}  // namespace penumbra::capture
