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

/// One standard deviation of the irradiance of surfaces, RMS over all normals, relative to the mean
/// irradiance.
struct LightUncertainty {
  /// By the frames' noise, as it is left in the harmonics; none before it has been measured on a
  /// stream, and of still maps.
  std::optional<double> noise;
  double unseen = 0;  // by what no camera sees
  /// By both; none where a light is known from below alone.
  std::optional<double> total;

  /// RMS error of the irradiance for each part of the sphere that no camera sees and that is
  /// continued from the rest. It is large, as a sun or a window may be there.
  /// source: measured, docs/methods/environment-assembly.md
  static constexpr double kContinued = 1.3;
};

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
  /// relative to the mean irradiance; from the bands up to 9 that were measured, so none for 9,
  /// nor where lights went into the harmonics later.
  std::optional<double> truncation_error;
  LightUncertainty uncertainty;
  std::optional<Plan> plan;  // of a governed estimator
  /// What surfaces mirror, but for the lights that lights_apart() names; null where none was asked
  /// for (LightEstimator::mirror).
  std::shared_ptr<const ReflectionMap> reflections{};

  Seconds age(TimestampNs now) const { return now - time; }
  /// Whether frames have the time for this light; false for those after the plan's.
  bool is_affordable(std::size_t light) const;
};

/// What frames have the time for: all other lights go into the harmonics.
void keep_affordable(LightEstimate& estimate);

/// The lights, by their places in the list, that surfaces mirror as discs: the first few of those
/// that are affordable, compact and smaller than the lobe of any of them. All others they show as
/// the map does.
inline constexpr std::size_t kMaxLightsApart = 4;
std::vector<std::size_t> lights_apart(const LightEstimate& light);

}  // namespace penumbra::lighting
#pragma GCC visibility pop
