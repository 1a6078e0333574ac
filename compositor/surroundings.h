// What surfaces with materials mirror.
// threads: plain values
#pragma once

#include <glm/vec3.hpp>
#include <memory>
#include <vector>

#include "core/image.h"
#include "core/sh.h"
#include "lighting/reflections/reflection_map.h"

#pragma GCC visibility push(default)
namespace penumbra::compositor {

/// A distant light as a disc.
struct MirroredLight {
  glm::dvec3 direction{0, 1, 0};  // towards its middle, unit
  double radius_rad = 0;
  Rgb irradiance{};  // of a surface that faces it
};

/// Of one moment, in the world's frame.
struct Surroundings {
  /// As many lights are mirrored apart; what else there is belongs into `reflections`.
  static constexpr std::size_t kMaxLights = 4;

  std::shared_ptr<const lighting::ReflectionMap> reflections{};  // null: nothing is mirrored
  std::vector<MirroredLight> lights{};
  RadianceSh light{1};  // all of it, for what a normal map changes
  /// Radiance that an emission of 1 has: of white paper in the light.
  float emission_unit = 1;
};

}  // namespace penumbra::compositor
#pragma GCC visibility pop
