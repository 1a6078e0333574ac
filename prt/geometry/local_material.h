// What a surface's material is at the place where a ray meets it.
// threads: reentrant
#pragma once

#include <array>
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>

#include "core/image.h"
#include "core/result.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// The values of a material at one place, its pictures read.
struct LocalMaterial {
  glm::vec3 plain{0, 1, 0};   // the surface's own normal, on the side that is seen; unit
  glm::vec3 normal{0, 1, 0};  // the same as a normal map leans it
  Rgb diffuse{};              // albedo of what is not mirrored
  Rgb reflectance{};          // 0..1, mirrored at normal incidence
  float grazing_reflectance = 1;
  float roughness = 1;
  float clearcoat = 0, clearcoat_roughness = 0;
  float opacity = 1;      // 0..1; a mask gives 0 or 1
  float transmitted = 0;  // 0..1, of what enters the surface
  Rgb emission{};         // in the material's own unit
  bool unlit = false;     // `emission` is all that it sends
};

/// Where a ray meets a triangle: (1-u-v) a + u b + v c.
struct TrianglePlace {
  std::array<std::uint32_t, 3> corners{};
  float u = 0, v = 0;
  bool front = true;
};

/// Between the four nearest texels, 0..1; white without a picture. What a display's curve encodes
/// is linear before it is mixed.
glm::vec4 sample(const Texture& texture, const glm::vec2& coordinates, bool srgb);

/// As glTF 2.0 has it: factors times pictures times vertex colours. Pictures of occlusion are left
/// out: what they stand for is traced.
/// in: a surface that check_surface() accepts for the mesh
LocalMaterial local_material(const Mesh& mesh, const SurfaceMaterials& surface,
                             const TrianglePlace& place);

/// Whether rays may pass through some place of it.
bool is_see_through(const Material& material);
/// Whether its backs are there for rays that meet them.
bool has_backs(const Material& material);

/// errors: kInvalid (not one entry for each vertex, an unknown material, a picture without pixels)
Result<void> check_surface(const Mesh& mesh, const SurfaceMaterials& surface);

}  // namespace penumbra::prt
#pragma GCC visibility pop
