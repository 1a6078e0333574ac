// The light as engines take it: /v1/light?as=three and others.
// threads: reentrant
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "core/result.h"
#include "lighting/light_estimate.h"

namespace penumbra::service {

/// in: as: three, webxr, arcore, godot, filament, unity or unreal
/// out: convention, sh (what is not in the lights; of three bands, red, green and blue of each),
///      total_sh (with them), sh_is ("radiance" or "irradiance over pi"), lights (direction,
///      irradiance, angular_diameter_deg)
/// errors: kInvalid (another name: says which there are)
/// source: service/client/penumbra_convert.h
Result<nlohmann::json> light_as(const lighting::LightEstimate& light, const std::string& as);

}  // namespace penumbra::service
