#include "codec/display.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <variant>

namespace penumbra::codec {

namespace {

// Codes by the upper bits of the float: a power costs as much as the rest of a frame's way to the
// screen. A bin is 1/256 wide relative to its value and holds at most one step between two codes,
// so the bin's first code and the step above it say the code exactly.
class SrgbTable {
 public:
  SrgbTable() {
    for (std::size_t code = 0; code + 1 < steps_.size(); ++code)
      steps_[code] = linear_from_srgb((static_cast<float>(code) + .5f) / 255);
    steps_.back() = std::numeric_limits<float>::infinity();
    for (std::size_t bin = 0; bin < first_.size(); ++bin) {
      const float low =
          std::bit_cast<float>((kFirstBin + static_cast<std::uint32_t>(bin)) << kShift);
      first_[bin] =
          static_cast<std::uint8_t>(std::ranges::upper_bound(steps_, low) - steps_.begin());
    }
  }
  std::uint8_t operator()(float linear) const {
    if (!(linear >= kDarkest)) return 0;
    if (linear >= 1) return 255;
    const std::size_t bin = (std::bit_cast<std::uint32_t>(linear) >> kShift) - kFirstBin;
    const std::uint8_t first = first_[bin];
    return static_cast<std::uint8_t>(first + (linear >= steps_[first] ? 1 : 0));
  }

 private:
  static constexpr float kDarkest = 0x1p-13f;  // below the first step, which is at 1.5e-4
  static constexpr int kShift = 15;
  static constexpr std::uint32_t kFirstBin = std::bit_cast<std::uint32_t>(kDarkest) >> kShift;
  static constexpr std::uint32_t kBins = (std::bit_cast<std::uint32_t>(1.f) >> kShift) - kFirstBin;
  std::array<float, 256> steps_{};  // the lowest value of the next code
  std::array<std::uint8_t, kBins> first_{};
};

}  // namespace

float linear_from_srgb(float code) {
  return code <= .04045f ? code / 12.92f : std::pow((code + .055f) / 1.055f, 2.4f);
}

std::uint8_t srgb_code(float linear) {
  static const SrgbTable table;
  return table(linear);
}

Image<Rgb8> to_display(const FramePixels& pixels, float exposure) {
  if (const auto* f8 = std::get_if<Image<Rgb8>>(&pixels)) return *f8;
  const auto convert = [](const auto& in, auto code) {
    Image<Rgb8> out(in.width(), in.height());
    for (std::size_t i = 0; i < in.area(); ++i) {
      const auto& p = in.pixels()[i];
      out.pixels()[i] = {code(p.r), code(p.g), code(p.b)};
    }
    return out;
  };
  if (const auto* f16 = std::get_if<Image<Rgb16>>(&pixels))
    return convert(*f16, [](std::uint16_t v) { return static_cast<std::uint8_t>(v >> 8); });
  return convert(std::get<Image<Rgb>>(pixels), [&](float v) { return srgb_code(v * exposure); });
}

}  // namespace penumbra::codec
