// How rough surfaces reflect: the GGX distribution of microfacets, and what it reflects of even
// light.
// threads: reentrant
#pragma once

#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// Half way vectors of samples of one GGX lobe, z along the normal, by its distribution over
/// projected area. alpha: roughness squared.
/// source: Walter, Marschner, Li & Torrance 2007, eq. 35; points of Hammersley's set
std::vector<glm::vec3> ggx_half_vectors(float alpha, int count);
/// D(m) of the same, 1/sr.
float ggx_density(float alpha, float n_dot_m);
/// G2/(4 n.l n.v) with both shadowings correlated.
/// source: Heitz 2014, eq. 99, for GGX
float ggx_visibility(float alpha, float n_dot_l, float n_dot_v);

/// What a GGX surface reflects of even light from all directions, for reflectance F0 at normal
/// incidence and F90 at grazing: F0 * x + F90 * y (Schlick's Fresnel term).
/// source: Karis 2013
glm::vec2 reflected_of_even(float n_dot_v, float roughness);

/// The same by n.v across and roughness down, both 0 at the first pixel and 1 at the last; made
/// once.
constexpr int kReflectedTable = 32;
const Image<glm::vec2>& reflected_of_even_table();

/// What is reflected again between the facets: a factor of what one reflection gives, so that a
/// white metal in even light reflects all of it. `one`: x + y of the above.
/// source: Turquin 2019
inline float more_than_once(float one, float reflectance) {
  return 1 + reflectance * (1 / one - 1);
}

}  // namespace penumbra::lighting
#pragma GCC visibility pop
