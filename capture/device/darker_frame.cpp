#include "capture/device/internal/darker_frame.h"

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <utility>
#include <variant>

namespace penumbra::capture {

namespace {

constexpr int kPatience = 12;     // frames until a request shows, with room
constexpr int kMaxDark = 3;       // in a row: more is another light
constexpr double kClearly = .75;  // of the brightness before
constexpr int kApart_px = 16;     // between the pixels that are read

}  // namespace

DarkerFrame::DarkerFrame(const calib::Response& response, Exposure exposure)
    : response_(response), exposure_(exposure) {}

// Mean signal, what is clipped at full scale: an overexposed picture is darker, too, once less of
// it is clipped.
double DarkerFrame::brightness(const FramePixels& pixels) const {
  return std::visit(
      [&](const auto& image) {
        using Pixel = std::remove_cvref_t<decltype(image.at(0, 0))>;
        double sum = 0, count = 0;
        for (int y = kApart_px / 2; y < image.height(); y += kApart_px)
          for (int x = kApart_px / 2; x < image.width(); x += kApart_px, ++count) {
            const auto green = static_cast<double>(image.at(x, y).g);
            if constexpr (std::is_same_v<Pixel, Rgb>)
              sum += std::clamp(green, 0., 1.);
            else
              sum += response_.decode(green / (std::is_same_v<Pixel, Rgb8> ? 255. : 65535.), 1);
          }
        return count > 0 ? sum / count : 0;
      },
      pixels);
}

bool DarkerFrame::is_darker(double now, const std::optional<Exposure>& applied,
                            Exposure usual) const {
  if (applied) return applied->product() < std::sqrt(exposure_.product() * usual.product());
  return before_ && now < kClearly * *before_;
}

DarkerFrame::Passed DarkerFrame::pass(Frame frame, const std::optional<Exposure>& applied) {
  const double now = brightness(*frame.pixels);
  over_ = ++passed_ >= kPatience;
  if (is_darker(now, applied, frame.exposure) && dark_in_a_row_ < kMaxDark && !over_) {
    ++dark_in_a_row_;
    if (!held_) held_ = std::move(frame);
    return {};
  }
  Passed out;
  // Where no frame is bright again it was the light that changed.
  if (held_ && !is_darker(now, applied, frame.exposure)) {
    out.darker = std::move(held_);
    out.darker->exposure = exposure_;
    out.darker->for_light = true;
    over_ = true;
  }
  over_ |= dark_in_a_row_ == kMaxDark;
  before_ = now;
  out.frame = std::move(frame);
  return out;
}

}  // namespace penumbra::capture
