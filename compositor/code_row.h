// The fused pass over 8-bit pixels: decode, shadow ratio, object, encode.
#pragma once

#include <cstddef>

#include "core/code_curve.h"
#include "core/image.h"

namespace penumbra::compositor {

/// `pixels` of one row in place; ratios r, g, b one a pixel; `object`: four floats a pixel (premultiplied signal and
/// coverage) or null. Pixels with coverage 0 and ratios of exactly 1 stay bit for bit. Returns how many were written.
std::size_t composite_codes(const CodeCurve& curve, const float* object, const float* r,
                            const float* g, const float* b, Rgb8* pixels, std::size_t count);

}  // namespace penumbra::compositor
