// Luminance of a pixel as tone mapping counts it.
// threads: reentrant
#pragma once

#include <algorithm>
#include <limits>

#include "core/conventions.h"
#include "core/image.h"

namespace penumbra::tone {

/// Components below 0, which no display shows, as 0.
inline Rgb without_negative(const Rgb& c) {
  return {std::max(c.r, 0.f), std::max(c.g, 0.f), std::max(c.b, 0.f)};
}

/// Finite for any finite pixel.
inline float luminance_of(const Rgb& c) {
  return std::min(luminance(without_negative(c)), std::numeric_limits<float>::max());
}

}  // namespace penumbra::tone
