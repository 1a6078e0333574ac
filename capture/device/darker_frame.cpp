#include "capture/device/internal/darker_frame.h"

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <utility>
#include <variant>

namespace penumbra::capture {

namespace {

constexpr int kMaxDelay_frames = 12;  // frames until a request shows, with room
constexpr int kMaxDark = 3;           // in a row: more is another light
constexpr int kApart_px = 16;         // between the pixels that are read
constexpr float kClipped = .95f;      // of full scale
constexpr float kDark = .03f;         // too dark to tell
constexpr double kTelling = .02;      // of all samples, at least
constexpr double kAgreeing = .8;      // of the telling ones
constexpr double kFactor = 1.5;       // of the signal that the exposures make one expect
constexpr float kRounding = .01f;     // of full scale

}  // namespace

DarkerFrame::DarkerFrame(const calib::Response& response, Exposure exposure, Exposure usual)
    : response_(response), exposure_(exposure), usual_(usual) {}

std::vector<float> DarkerFrame::sample(const FramePixels& pixels) const {
  return std::visit(
      [&](const auto& image) {
        using Pixel = std::remove_cvref_t<decltype(image.at(0, 0))>;
        std::vector<float> out;
        for (int y = kApart_px / 2; y < image.height(); y += kApart_px)
          for (int x = kApart_px / 2; x < image.width(); x += kApart_px) {
            const auto green = static_cast<double>(image.at(x, y).g);
            const double full = std::is_same_v<Pixel, Rgb8> ? 255 : 65535;
            out.push_back(static_cast<float>(
                std::is_same_v<Pixel, Rgb> ? green : response_.decode(green / full, 1)));
          }
        return out;
      },
      pixels);
}

bool DarkerFrame::is_darker(const std::vector<float>& now,
                            const std::optional<Exposure>& applied) const {
  if (applied) return applied->product() < std::sqrt(exposure_.product() * usual_.product());
  const auto ratio = static_cast<float>(exposure_.product() / usual_.product());
  std::size_t telling = 0, agreeing = 0;
  for (std::size_t i = 0; i < std::min(before_.size(), now.size()); ++i) {
    const float expected = before_[i] * ratio;
    if (before_[i] >= kClipped) {
      if (now[i] >= kClipped) continue;  // too bright for either
      ++telling, agreeing += now[i] > expected / static_cast<float>(kFactor) - kRounding;
    } else if (before_[i] > kDark) {
      const float off = static_cast<float>(kFactor - 1) * expected + kRounding;
      ++telling, agreeing += std::abs(now[i] - expected) < off;
    }
  }
  return double(telling) > kTelling * double(now.size()) &&
         double(agreeing) > kAgreeing * double(telling);
}

DarkerFrame::Passed DarkerFrame::pass(Frame frame, const std::optional<Exposure>& applied) {
  std::vector<float> now = sample(*frame.pixels);
  over_ = ++passed_ >= kMaxDelay_frames;
  const bool darker = is_darker(now, applied);
  if (darker && dark_in_a_row_ < kMaxDark && !over_) {
    ++dark_in_a_row_;
    if (!held_) held_ = std::move(frame);
    return {};
  }
  Passed out;
  // Where no frame is bright again it was the light that changed.
  if (held_ && !darker) {
    out.darker = std::move(held_);
    out.darker->exposure = exposure_;
    out.darker->for_light = true;
    over_ = found_ = true;
  }
  over_ |= dark_in_a_row_ == kMaxDark;
  const auto white = std::ranges::count_if(now, [](float v) { return v >= kClipped; });
  white_ = double(white) > (1 - kTelling) * double(now.size());
  before_ = std::move(now);
  out.frame = std::move(frame);
  return out;
}

}  // namespace penumbra::capture
