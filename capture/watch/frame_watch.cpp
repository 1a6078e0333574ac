#include "capture/watch/frame_watch.h"

#include <cmath>
#include <utility>

#include "core/io/log.h"

namespace penumbra::capture {

namespace {

bool same_kind(const FramePixels& a, const FramePixels& b) {
  return a.index() == b.index() && width(a) == width(b) && height(a) == height(b);
}

}  // namespace

std::optional<Exposure> FrameWatch::exposure_of(const Frame& frame) {
  const std::uint64_t number = labelled_++;
  labels_.requested(number, frame.exposure);
  const auto label = labels_.judge(number, frame.time, brightness_.measure(*frame.pixels));
  if (label.verdict == ExposureLabels::Verdict::kRefused) {
    if (!std::exchange(said_label_, true))
      log_warning(
          "{}: frame {} does not show the exposure of {:.4g} s that it is said to have: "
          "such frames are left out",
          name_, frame.sequence, frame.exposure.time.count());
    return std::nullopt;
  }
  if (label.verdict != ExposureLabels::Verdict::kGood || labels_.delay() == 0)
    return frame.exposure;
  if (!std::exchange(said_delay_, true))
    log_warning("{}: its frames show the exposures of other frames, as those {} before them", name_,
                labels_.delay().value_or(0));
  return label.exposure;
}

Frame FrameWatch::steady(const Frame& frame, const Exposure& nominal, const Frame* shorter) {
  const PictureHistory::Comparison& compared = history_.compare(frame, nominal);
  if (compared.now.empty()) return frame;
  watch_balance(compared);
  const auto wave = bands_.find(compared);
  if (bands_.light_changed()) history_.scale_to_now();
  if (bands_.scene_changed()) history_.begin_anew();
  rows_.clear();
  for (int row = 0; wave && row < PictureHistory::kGrid.rows; ++row) {
    const double place = (row + .5) / PictureHistory::kGrid.rows;
    rows_.push_back(wave->at(place) - bands_.standing().at(place));
  }
  history_.keep(rows_);
  if (!wave) return frame;
  if (!std::exchange(said_bands_, true))
    log_info(
        "{}: light on the mains leaves {:.1f} bands of {:.0f} % in its frames: they are taken out",
        name_, wave->cycles, 100 * std::expm1(wave->amplitude()));
  const int bits = std::holds_alternative<Image<Rgb16>>(*frame.pixels) ? 16 : 8;
  Frame out = frame;
  BandRemoval removal{*wave, history_.meter().curve(bits), black_level_};
  if (shorter && same_kind(*shorter->pixels, *frame.pixels)) {
    removal.shorter = shorter->pixels.get();
    removal.ratio = frame.exposure.product() / shorter->exposure.product();
  }
  out.pixels = without_bands(*frame.pixels, removal);
  return out;
}

void FrameWatch::watch_balance(const PictureHistory::Comparison& compared) {
  const auto shift = balance_.see(compared);
  if (!shift || std::exchange(said_balance_, true)) return;
  log_warning(
      "{}: its colours change alike everywhere, red by {:+.0f} % and blue by {:+.0f} % against "
      "green: its white balance follows the picture, and with it the colour of the light; fix it "
      "in the camera",
      name_, 100 * std::expm1(shift->red), 100 * std::expm1(shift->blue));
}

}  // namespace penumbra::capture
