// What an engine asks for: the light estimate.
// threads: plain values
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/sh.h"
#include "core/units.h"
#include "lighting/governor.h"
#include "lighting/lights/distant_light.h"
#include "lighting/reflections/reflection_map.h"
#include "lighting/sh/projection.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// What an engine asks for.
struct LightEstimate {
  RadianceSh light{1};  // of the whole sphere without the lights
  // Likewise, for what stands on a horizontal floor, see upper_hemisphere_light()
  RadianceSh upper_hemisphere_light{1};
  std::vector<DistantLight> lights;  // compact sources, by falling irradiance
  TimestampNs time;                  // capture time of the newest frame in it
  bool valid = false;                // false until a first environment has been measured
  double coverage = 0;               // of the sphere
  double clipped_fraction = 0;       // of the sphere's solid angle, saturated in every exposure
  Rgb mean_radiance;                 // over the sphere
  /// RMS error over all normals of unshadowed irradiance by leaving out bands >= light.bands(),
  /// relative to the mean irradiance; from the bands up to 9 that were measured, so none for 9.
  std::optional<double> truncation_error;
  std::optional<Plan> plan;  // of a governed estimator
  /// What surfaces mirror, but for the lights that lights_apart() names; null where none was asked
  /// for (LightEstimator::mirror).
  std::shared_ptr<const ReflectionMap> reflections{};

  Seconds age(TimestampNs now) const { return now - time; }
};

/// The lights, by their places in the list, that surfaces mirror as discs: the first few of those
/// that are compact and smaller than the lobe of any of them. All others they show as the map does.
inline constexpr std::size_t kMaxLightsApart = 4;
std::vector<std::size_t> lights_apart(const LightEstimate& light);

}  // namespace penumbra::lighting
#pragma GCC visibility pop
