// Saturated light recovered from one open surface.
#pragma once

#include "lighting/lighting.h"

namespace penumbra::test {

/// A matte surface of known albedo that nothing shades, on the scale of the environment's radiance.
struct ReflectancePatch {
  glm::dvec3 normal{0, 1, 0};
  Rgb radiance;
  Rgb albedo;
};

inline Result<std::vector<lighting::SaturationRecovery>> recover_from_patch(
    const lighting::LightEstimate& light, const ReflectancePatch& patch) {
  const lighting::ShadowRegion all{patch.radiance};
  PENUMBRA_ASSIGN(found,
                  lighting::recover_from_shadows(light, {patch.normal, {&all, 1}, patch.albedo}));
  return std::move(found.powers);
}

}  // namespace penumbra::test
