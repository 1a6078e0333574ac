// What a material does with the light that meets it, and directions in which to look for that.
// threads: reentrant
#pragma once

#include <array>
#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>

#include "core/image.h"
#include "prt/geometry/local_material.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// Diffuse light, what is mirrored, and what a clear coat mirrors, seen from one direction.
/// source: glTF 2.0, appendix B; Walter et al. 2007 and Heitz 2014 (GGX); Turquin 2019 (what facets
/// reflect again); differs: (1 - fraction) of diffuse light is left below what is mirrored, by what
/// is mirrored of even light towards the viewer alone, so the two ways of light are not alike
class MaterialLobes {
 public:
  /// Mirrors are this rough at least: alpha, where roughness is its root.
  static constexpr float kMinWidth = 1e-3f;

  /// in: towards_viewer: unit; a little above the surface where it is not
  MaterialLobes(const LocalMaterial& material, const glm::vec3& towards_viewer);

  /// Reflected radiance per irradiance, times the cosine: 0 below the surface.
  Rgb evaluate(const glm::vec3& towards_light) const;
  /// Of sample(), per steradian.
  float density(const glm::vec3& towards_light) const;
  struct Bounce {
    glm::vec3 towards_light{};
    Rgb weight{};       // evaluate() over the density
    float density = 0;  // 0: a direction below the surface, from which nothing comes
  };
  /// in: u1, u2: 0..1, even
  Bounce sample(float u1, float u2) const;

  /// Radiance that it sends by itself, in the material's unit.
  Rgb emission() const;
  /// Of what is behind, so much is not seen: 0..1. What it sends counts by its opacity alone.
  float cover() const { return cover_; }

 private:
  struct Lobe {
    float alpha = 1;    // GGX width
    Rgb reflectance{};  // at normal incidence
    float grazing = 1;  // at grazing incidence
    Rgb factor{};
    float chance = 0;  // of being sampled
  };
  float lobe_density(const Lobe& lobe, const glm::vec3& towards_light) const;
  Rgb lobe_value(const Lobe& lobe, const glm::vec3& towards_light) const;
  Rgb value_here(const glm::vec3& towards_light) const;
  float density_here(const glm::vec3& towards_light) const;

  glm::mat3 world_from_here_;  // here: z along the normal
  glm::vec3 viewer_, plain_;   // plain_ and below: here
  std::array<Lobe, 2> lobes_;  // surface, coat
  Rgb diffuse_{};              // what is reflected evenly, over pi
  float diffuse_chance_ = 0;
  Rgb emission_{};
  float cover_ = 1;
};

}  // namespace penumbra::prt
#pragma GCC visibility pop
