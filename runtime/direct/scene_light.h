// Which part of the light reaches what stands level on a floor, and what does not.
// threads: reentrant
#pragma once

#include <span>

#include "core/image.h"
#include "core/pose.h"
#include "core/sh.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "prt/bake/bake.h"
#include "prt/geometry/plane.h"
#include "prt/transfer/transfer.h"

namespace penumbra::runtime {

/// Light whose largest possible effect, by a bound that is loose two to ten times, is below this
/// fraction of the mean cannot be seen in 8 bits.
inline constexpr double kVisibleChange = .01;

/// A plane counts as level when its normal's y is larger: within a quarter of a degree.
inline constexpr double kLevel = .99999;
/// A baked thing that stands on a level floor takes the floor's light
/// (lighting::upper_hemisphere_light), any other the sphere's.
inline bool stands_level(const prt::BakedObject& baked, const Pose& world_from_bake) {
  return baked.receiver && (world_from_bake.rotation * glm::dvec3(0, 1, 0)).y > kLevel;
}
/// The residual, and one light for what is reflected of it (kReflectedBands), world frame.
const RadianceSh& residual_for(const lighting::LightEstimate& light, bool level);
RadianceSh reflected_for(const lighting::DistantLight& source, bool level);
/// A sum of reflected_for turned into the bake frame.
/// in: bands that the bake keeps of reflected light, 1..kReflectedBands: a fit of more would leave
/// out part of its own
RadianceSh reflected_in_bake_frame(const RadianceSh& sum, bool level, const Pose& world_from_bake,
                                   int bands = prt::kReflectedBands);
/// Irradiance of an open plane of this orientation, lights included.
Rgb open_irradiance(const lighting::LightEstimate& light, const glm::dvec3& normal);
/// Radiance that a material's emission of 1 has: of white paper that lies in the light.
float emission_unit(const lighting::LightEstimate& light);

}  // namespace penumbra::runtime
