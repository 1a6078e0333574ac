// What surfaces with materials mirror.
// threads: plain values
#pragma once

#include <glm/vec3.hpp>
#include <memory>
#include <vector>

#include "core/image.h"
#include "core/sh.h"
#include "lighting/reflections/reflection_map.h"
#include "prt/geometry/material.h"

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
  RadianceSh light{1};  // beside them, for what a normal map changes
  /// Radiance that an emission of 1 has: of white paper in the light.
  float emission_unit = 1;
};

/// Whether rays tell what a surface mirrors of virtual objects. Rougher ones are matt nearly: their
/// transfer says better what hides the surroundings from them.
inline bool mirrors_objects(const prt::Material& m) {
  constexpr float kRoughest = .7f;
  return !m.unlit && (m.roughness <= kRoughest || m.metallic_roughness_map);
}

/// What an object with materials mirrors of virtual objects, itself among them, in one view.
struct MirroredPicture {
  int x0 = 0, y0 = 0, step = 1;  // a texel is a square of `step` pixels, the first one's corner
  Image<Rgb> light{};            // mean radiance over a lobe, 0 where it meets nothing
  Image<Rgb> open{};             // what it sees of the surroundings past them, 0..1
};

}  // namespace penumbra::compositor
#pragma GCC visibility pop
