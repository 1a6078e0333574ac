// The fused pass over 8-bit pixels: decode, shadow ratio, object, encode.
#pragma once

#include <cstddef>

#include "calib/camera/response_table.h"
#include "core/image.h"

namespace penumbra::compositor {

inline constexpr float kClipping = .95f;  // of the largest code's signal: from there on

/// A code's signal where the largest one stands for `clipped`, if that is more: codes near it
/// follow, since noise mixes them.
inline float decode_clipped(const ResponseTable& curve, int channel, unsigned code, float clipped) {
  const float signal = curve.decode(channel, code),
              largest = curve.decode(channel, curve.largest_code());
  const float above = signal - kClipping * largest;
  if (!(clipped > largest && above > 0)) return signal;
  return signal + (clipped - largest) * above / (largest - kClipping * largest);
}

/// `pixels` of one row in place; ratios r, g, b one a pixel; `object`: four floats a pixel
/// (premultiplied signal and coverage) or null; `clipped`: the signal of code 255, as
/// decode_clipped. Pixels with coverage 0 and ratios of exactly 1 stay bit for bit. Returns how
/// many were written.
std::size_t composite_codes(const ResponseTable& curve, const Rgb& clipped, const float* object,
                            const float* r, const float* g, const float* b, Rgb8* pixels,
                            std::size_t count);

/// Three planes of a row, `stride` floats apart, with room for kSensorLanes - 1 floats more than it
/// has pixels.
struct SignalRows {
  float *signal, *rounding;
  std::size_t stride;
};
/// Codes to signal, as decode_clipped, and to the variance that their rounding left in it: by
/// channel, 256 values each.
void decode_codes(const ResponseTable& curve, const Rgb& clipped, const float* const* roundings,
                  const Rgb8* pixels, std::size_t count, const SignalRows& out);
/// Signal to codes, of pixels that are touched (not 0).
void encode_codes(const ResponseTable& curve, const SignalRows& in, const std::uint32_t* touched,
                  std::size_t count, Rgb8* pixels);

}  // namespace penumbra::compositor
