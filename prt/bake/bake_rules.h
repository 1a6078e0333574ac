// What every bake of transfer agrees on, before the show or during it.
// threads: reentrant
#pragma once

#include <cmath>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// In radii of the object: rays start clear of their own surface.
inline constexpr float kRayNear = 1e-4f;
/// In radii from the object's middle: receiver points beyond send their rays into the cone that it
/// fills, others all around.
inline constexpr float kConeFrom = 1.15f;
/// A point that sees a larger fraction of back faces lies within something.
inline constexpr float kHiddenFraction = .25f;

/// Bands of a character's reflected light. It is smooth, but where lights are split off their whole
/// reflection comes from these bands: under a sharp sun three leave 3.4 % of the light out, five
/// 1.2 %, seven none (walker, rustig_koppie).
constexpr int reflected_bands(int bands) {
  return bands > 3 ? 6 : bands;
}

/// One channel of transfer serves all three colours.
inline bool is_grey(const Rgb& albedo) {
  return std::abs(albedo.r - albedo.g) < 1e-3f && std::abs(albedo.g - albedo.b) < 1e-3f;
}

}  // namespace penumbra::prt
#pragma GCC visibility pop
