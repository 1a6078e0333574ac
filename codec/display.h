// Frames as screens, videos and JPEG files take them.
// threads: reentrant
#pragma once

#include <cstdint>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::codec {

/// Eight-bit sRGB code of a linear component. Below 0 and NaN are 0, above 1 is 255.
/// source:  IEC 61966-2-1, rounded to the nearest code
std::uint8_t srgb_code(float linear);

/// Linear component of an sRGB code 0..1, of any number of bits.
/// source:  IEC 61966-2-1
float linear_from_srgb(float code);

/// Eight-bit picture of any frame, for video, JPEG and windows: 16 bit loses its low byte, float
/// frames go through sRGB with `exposure`. `tone::tone_map` shows what lies above white, too.
Image<Rgb8> to_display(const FramePixels& pixels, float exposure = 1);

}  // namespace penumbra::codec
#pragma GCC visibility pop
