// Light sources followed from map to map.
// threads: thread-bound
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "core/units.h"
#include "lighting/lights/distant_light.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// Gives the same source the same number from map to map, and lets a source enter the list over
/// kFade: what it does not carry yet stays in the harmonics, so energy never jumps, only sharpness
/// fades in. A source enters at `ExtractionOptions::min_irradiance_fraction` and leaves below half
/// of it; where sources part or join, what was in the list stays in it.
/// threads: thread-bound
class LightTracker {
 public:
  static constexpr Seconds kFade{.2};

  /// in:  what extract_lights found at half of min_irradiance_fraction, mean_irradiance = pi times
  /// the mean radiance
  /// out: `lights` holds what is used, its radiance times its weight; unused the rest of it, as
  /// lights
  void update(TimestampNs time, double min_irradiance_fraction, double mean_irradiance,
              std::vector<DistantLight>& lights, std::vector<DistantLight>& unused);

 private:
  struct TrackedLight {
    DistantLight source;
    float weight;
  };
  struct Lost {
    DistantLight source;
    TimestampNs since;
  };
  struct FoundLight {
    DistantLight source;
    std::optional<std::size_t> before;  // in known_
  };
  std::optional<std::size_t> match(const DistantLight& source, std::span<const char> taken) const;
  int number_of(const DistantLight& source, TimestampNs time);

  std::vector<TrackedLight> known_, now_;
  std::vector<Lost> lost_;
  std::vector<FoundLight> found_;
  TimestampNs time_;
  int next_id_ = 1;
  bool first_ = true;
};

}  // namespace penumbra::lighting
#pragma GCC visibility pop
