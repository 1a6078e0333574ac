// Spherical-harmonic lights whose effects are known.
#pragma once

#include <cmath>
#include <random>

#include "core/conventions.h"
#include "core/sh.h"

namespace penumbra::test {

/// The same radiance from everywhere.
inline RadianceSh constant_light(Rgb radiance, int bands = 1) {
  RadianceSh light(bands);
  light[0] = radiance * static_cast<float>(std::sqrt(4 * kPi));
  return light;
}

/// L(d) = base + slope . d, positive everywhere when |slope| < base.
inline RadianceSh sloped_light(float base, const glm::dvec3& slope, int bands = 2) {
  RadianceSh light = constant_light({base, base, base}, bands);
  const double k = std::sqrt(4 * kPi / 3);  // Y_1 = (y, z, x)/k
  light[1] = Rgb{1, 1, 1} * static_cast<float>(k * slope.y);
  light[2] = Rgb{1, 1, 1} * static_cast<float>(k * slope.z);
  light[3] = Rgb{1, 1, 1} * static_cast<float>(k * slope.x);
  return light;
}

/// A mean of one with every other coefficient at random, its three colours different.
inline RadianceSh random_light(int bands, unsigned seed, float spread = .3f) {
  std::mt19937 rng(seed);
  std::normal_distribution<float> gauss(0, spread);
  RadianceSh light(bands);
  for (Rgb& t : light.terms()) t = {gauss(rng), gauss(rng), gauss(rng)};
  light[0] = Rgb{1, 1, 1} * static_cast<float>(std::sqrt(4 * kPi));
  return light;
}

}  // namespace penumbra::test
