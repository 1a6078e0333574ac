// Surfaces that send light of their own, as points that stand for them.
// threads: reentrant
#pragma once

#include <string>
#include <vector>

#include "core/image.h"
#include "prt/geometry/local_material.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// What of a mesh one material makes luminous.
struct LuminousPart {
  std::string material;
  bool double_sided = false;
  Rgb emission_m2;     // emission times area, over the whole part: one colour for all of it
  float point_m2 = 0;  // area that a point stands for: of where most of the light is
  // Each stands for the same share of the light, as a triangle's corners and a place in it
  std::vector<TrianglePlace> points;
};

/// Of each material whose emission is not black; unlit ones do not count, nor what has no area. A
/// picture of emission is read at four places of each triangle. The brightest part first.
/// in: a surface that check_surface() accepts for the mesh
std::vector<LuminousPart> luminous_parts(const Mesh& mesh, const SurfaceMaterials& surface,
                                         int points);

}  // namespace penumbra::prt
#pragma GCC visibility pop
