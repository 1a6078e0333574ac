#include "runtime/direct/scene_light.h"

#include <algorithm>

#include "core/conventions.h"
#include "lighting/estimate.h"
#include "lighting/lights/distant_light.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/projection.h"
#include "lighting/sh/rotation.h"
#include "prt/transfer/transfer.h"

namespace penumbra::runtime {

const RadianceSh& residual_for(const lighting::LightEstimate& light, bool level) {
  return level ? light.upper_hemisphere_light : light.light;
}

RadianceSh reflected_for(const lighting::DistantLight& source, bool level) {
  return level ? lighting::project_upper_distant_light(source, prt::kReflectedBands)
               : lighting::project_distant_light(source, prt::kReflectedBands);
}

RadianceSh reflected_in_bake_frame(const RadianceSh& sum, bool level, const Pose& world_from_bake,
                                   int bands) {
  const lighting::ShRotation turn(glm::transpose(world_from_bake.rotation_matrix()), bands);
  return (turn * (level ? lighting::upper_hemisphere_light(sum, bands) : sum.with_bands(bands)))
      .with_bands(prt::kReflectedBands);
}

Rgb open_irradiance(const lighting::LightEstimate& light, const glm::dvec3& normal) {
  Rgb sum = lighting::evaluate(
      lighting::irradiance(normal.y > kLevel ? light.upper_hemisphere_light : light.light), normal);
  for (const lighting::DistantLight& d : light.lights) sum += lighting::irradiance(d, normal);
  return sum;
}

float emission_unit(const lighting::LightEstimate& light) {
  const Rgb up = lighting::evaluate(lighting::irradiance(lighting::whole_light(light)), {0, 1, 0});
  return std::max(0.f, luminance(up)) * static_cast<float>(1 / kPi);
}

}  // namespace penumbra::runtime
