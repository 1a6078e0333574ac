// What a virtual object does to the light on the real plane under it.
// threads: reentrant; compose_planar_shadow does not allocate once `out` has its size
#pragma once

#include <cstddef>
#include <glm/ext/vector_int2.hpp>
#include <glm/vec2.hpp>
#include <optional>
#include <span>

#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "core/sh.h"
#include "prt/bake/bake.h"
#include "prt/geometry/receiver.h"

#pragma GCC visibility push(default)
namespace penumbra::shadows {

/// The ratio s = E/E0 on the receiver at the texels of the object's ground grid. Exactly 1 where
/// the object's influence cannot be seen.
struct PlanarShadow {
  Image<Rgb> ratio;
  /// Texels [x0, x1) x [y0, y1) that hold everything different from 1; empty when x0 >= x1.
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  bool empty() const { return x0 >= x1 || y0 >= y1; }
};

/// The texel that holds a place on the plane, x and z in the bake frame; nothing outside the grid.
std::optional<glm::ivec2> texel_at(const prt::GroundGrid& grid, const glm::vec2& position);

/// Of the texel that holds a place on the plane, x and z in the bake frame; 1 outside the grid.
Rgb ratio_at(const PlanarShadow& shadow, const prt::GroundGrid& grid, const glm::vec2& position);

/// Ratios closer to 1 than this are 1 (a third of an 8-bit sRGB code at most); up to twice as far
/// they are faded in, so that the border cannot be seen. This is what keeps the touched area small.
inline constexpr float kInvisibleRatio = .003f;
/// Where E0 is below this fraction of the mean over all directions, the ratio form has no footing:
/// s = 1.
inline constexpr float kMinIrradiance = .05f;

/// Light on a receiver, in its bake frame.
struct ReceiverLight {
  // NOLINTNEXTLINE: a residual alone is a light
  ReceiverLight(const RadianceSh& rest_) : residual(rest_) {}
  RadianceSh residual;  // without the lights
  // The lights in spherical harmonics, for the light that the object reflects
  RadianceSh lights{1};
  Rgb distant_irradiance;  // E of all lights on the open receiver, W/m^2 relative
};

/// What the object takes of the receiver's irradiance/pi at its grid's texels under the residual,
/// less what it reflects of `lights`, in prt::relight's layout.
struct ReceiverChange {
  const prt::GroundGrid& grid;
  int bands;  // of the deficit
  std::size_t stride;
  std::span<const float> deficit;
};
void compose_planar_shadow(const ReceiverChange& change, const ReceiverLight& light,
                           PlanarShadow& out);

/// s = 1 - (sum l_n S_n - light reflected from lights)/E0 from the baked deficit basis S_n, clamped
/// to 0..1.5, faded to 1 over the outer tenth of the grid. E0 counts the lights; what of them the
/// object blocks is ShadowMap's. `light` in the bake frame: a yaw of the object is a rotation of
/// the light.
/// in:     object with a receiver
/// errors: kInvalid (no receiver)
Result<void> compose_planar_shadow(const prt::BakedObject& object, const ReceiverLight& light,
                                   PlanarShadow& out);

struct PlacedShadow {
  const prt::BakedObject* object;
  Pose world_from_bake;  // both on one plane
  const PlanarShadow* shadow;
};

/// Shadows of two objects are multiplied where they meet, which darkens twice where both block the
/// same directions. This changes the second's ratio (`out`, a copy of second.shadow) so that the
/// product is 1 - (d_a + d_b - what they block in common), the common part from the correlation of
/// their deficits over all directions. It lies within max(d) .. min(1, sum d); equal objects in one
/// place darken once, separate directions add up. So with what both brighten by reflected light.
/// threads: reentrant, parallel inside; no allocation
void combine_shadows(const PlacedShadow& first, const PlacedShadow& second, PlanarShadow& out);

}  // namespace penumbra::shadows
#pragma GCC visibility pop
