#include "codec/display.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <variant>

namespace penumbra::codec {

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
  return convert(std::get<Image<Rgb>>(pixels), [&](float v) {
    const float x = std::clamp(v * exposure, 0.f, 1.f);  // IEC 61966-2-1
    const float y = x <= .0031308f ? 12.92f * x : 1.055f * std::pow(x, 1 / 2.4f) - .055f;
    return static_cast<std::uint8_t>(y * 255 + .5f);
  });
}

}  // namespace penumbra::codec
