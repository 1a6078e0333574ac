// Irradiance in spherical harmonics.
// threads: reentrant
#pragma once

#include <glm/vec3.hpp>

#include "core/image.h"
#include "core/sh.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// A_l of the clamped cosine: pi, 2pi/3, pi/4, 0, -pi/24, 0, ... for any l >= 0.
/// source: Ramamoorthi & Hanrahan 2001, eq. 8
double cosine_coefficient(int l);

/// E_n = A_l l_n: the irradiance of an unshadowed surface as a function of its normal.
IrradianceSh irradiance(const RadianceSh& light);
Rgb evaluate(const IrradianceSh& irradiance, const glm::dvec3& normal);

}  // namespace penumbra::lighting
#pragma GCC visibility pop
