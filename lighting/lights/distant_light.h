// One compact light source.
// threads: reentrant
#pragma once

#include <glm/vec3.hpp>

#include "core/image.h"
#include "core/sh.h"
#include "core/units.h"
#include "lighting/lights/inplace_vector.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// A source above the low-frequency residual: uniform radiance over a spherical cap, or over
/// another form of the same solid angle.
struct DistantLight {
  static constexpr int kShapePoints = 64;
  using Shape = InplaceVector<glm::dvec3, kShapePoints>;

  int id = 0;                     // the same source keeps its number over time (LightTracker)
  glm::dvec3 direction{0, 1, 0};  // to the centre of its energy, unit
  Radians radius{0};              // half angle
  Rgb radiance;                   // mean over the cap, on top of the residual
  /// Where a round light would misplace its energy (bands of windows, long lamps): kShapePoints
  /// unit directions of equal energy, neighbours in neighbouring places at every power of two; else
  /// empty.
  Shape shape{};
  bool clipped = false;    // saturated in every exposure
  bool recovered = false;  // clipped, and its power is known from elsewhere (saturation_recovery.h)

  /// The light sends at least this radiance, nobody knows how much more.
  bool is_lower_bound() const { return clipped && !recovered; }
  double solid_angle_sr() const;
  /// Of a surface that faces the round light: L pi sin^2 a.
  Rgb irradiance() const;
};

/// The light's own coefficients.
/// source: zonal harmonics of a cap, z_l = sqrt(pi/(2l+1)) (P_{l-1}(cos a) - P_{l+1}(cos a))
RadianceSh project_distant_light(const DistantLight& source, int bands);
/// Moments over directions with y > 0 alone, as ShProjection::upper_moments.
RadianceSh project_upper_distant_light(const DistantLight& source, int bands);
/// Of an open surface; the part of the light behind it is left out.
Rgb irradiance(const DistantLight& source, const glm::dvec3& normal);

}  // namespace penumbra::lighting
#pragma GCC visibility pop
