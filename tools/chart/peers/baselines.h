// What others do, expressed in our own pipeline so that one harness measures all: the light of a
// baseline and the object as it treats it.
#pragma once

#include "core/image.h"
#include "core/result.h"
#include "lighting/light_estimate.h"
#include "runtime/scene/scene.h"

namespace penumbra::tools {

/// The environment as `count` point lights of equal energy (a power of two) and nothing else.
/// source: Debevec 2005, "A Median Cut Algorithm for Light Probe Sampling"
lighting::LightEstimate sampled_lights(const Image<Rgb>& map, int count);

/// Ambient light and one hard light, the form that phones give: the direction and strength that
/// four coefficients suggest, the rest spread evenly.
/// source: dominant direction from the linear band, Sloan 2008, "Stupid Spherical Harmonics Tricks"
lighting::LightEstimate phone_light(const Image<Rgb>& map);

/// Nine coefficients of the whole sphere, no lights: Xu 2005.
lighting::LightEstimate dissertation_light(const Image<Rgb>& map);

/// The scene with objects that neither shade themselves nor the floor.
runtime::PreparedScene without_shadows(const runtime::PreparedScene& scene);
/// The scene with objects that cast no shadow on the floor.
runtime::PreparedScene without_floor_shadow(const runtime::PreparedScene& scene);
/// The scene with visibility as one number a point, the same for every direction.
runtime::PreparedScene with_ambient_occlusion(const runtime::PreparedScene& scene);

}  // namespace penumbra::tools
