// Real spherical harmonics (basis, sign and index: core/conventions.h).
// threads: reentrant
#pragma once

#include <glm/vec3.hpp>
#include <span>

#include "core/image.h"
#include "core/sh.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// Y_n(d) for n < bands^2; `direction` must be a unit vector, out must hold bands^2 values.
/// source: fully normalised associated Legendre recursion (Holmes & Featherstone 2002, eq. 11-13)
void evaluate_basis(int bands, const glm::dvec3& direction, std::span<double> out);

/// Sixteen directions at once in float: out[n * 16 + lane]. For bakes.
inline constexpr int kBasisLanes = 16;
void evaluate_basis_block(int bands, const float* x, const float* y, const float* z, float* out);

/// Radiance L(d) = sum l_n Y_n(d); negative lobes are kept.
Rgb evaluate(const RadianceSh& light, const glm::dvec3& direction);

}  // namespace penumbra::lighting
#pragma GCC visibility pop
