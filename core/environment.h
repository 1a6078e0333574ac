// Where capture and lighting meet: one HDR lat-long picture of the surroundings.
// threads: plain values
#pragma once

#include <cstdint>
#include <vector>

#include "core/image.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra {

struct Environment {
  Image<Rgb> radiance;      // lat-long (conventions.h), linear relative radiance; 0 where not seen
  Image<float> confidence;  // 0 = not seen, 1 = measured; empty when every pixel is measured
  TimestampNs time;         // capture time of the newest frame in it
  double clipped_fraction = 0;  // of the solid angle: saturated in every exposure
  double black_fraction = 0;    // of the solid angle: below the noise in every exposure
  /// Where a clipped sample took part, so that the radiance is a lower bound: pixels y * width + x,
  /// ascending; empty when nothing is clipped.
  std::vector<std::uint32_t> clipped{};
};

/// As files hold it: 1 where the radiance is a lower bound, 0 elsewhere; empty where it is none.
inline Image<float> clipped_pixels(const Environment& map) {
  if (map.clipped.empty()) return {};
  Image<float> out(map.radiance.width(), map.radiance.height());
  for (const std::uint32_t i : map.clipped) out.pixels()[i] = 1;
  return out;
}

}  // namespace penumbra
#pragma GCC visibility pop
