// What a virtual object does to the light on the real receiver under it.
// threads: reentrant; compose_planar_shadow does not allocate once `out` has its size
#pragma once

#include "core/image.h"
#include "core/result.h"
#include "core/sh.h"
#include "prt/prt.h"

namespace penumbra::shadows {

/// The ratio s = E/E0 on the receiver at the texels of the object's ground grid. Exactly 1 where
/// the object's influence cannot be seen.
struct PlanarShadow {
  Image<Rgb> ratio;
  /// Texels [x0, x1) x [y0, y1) that hold everything different from 1; empty when x0 >= x1.
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  bool empty() const { return x0 >= x1 || y0 >= y1; }
};

/// Ratios closer to 1 than this are 1 (a third of an 8-bit sRGB code at most); up to twice as far
/// they are faded in, so that the border cannot be seen. This is what keeps the touched area small.
inline constexpr float kInvisibleRatio = .003f;
/// Where E0 is below this share of the mean over all directions, the ratio form has no footing: s
/// = 1.
inline constexpr float kLeastIrradiance = .05f;

/// s = 1 - sum l_n S_n / E0 from the baked deficit basis S_n, clamped to 0..1.5, faded to 1 over
/// the outer tenth of the grid. `light` in the bake frame: a yaw of the object is a rotation of the
/// light. in:     object with a receiver
/// errors: kInvalid (no receiver)
Result<void> compose_planar_shadow(const prt::BakedObject& object, const RadianceSh& light,
                                   PlanarShadow& out);

}  // namespace penumbra::shadows
