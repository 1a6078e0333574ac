// Holes that a mask cuts into a surface, as geometry: light and shadow go through them.
// threads: reentrant
#pragma once

#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// Coverage of a material at a place of its texture, 0..1: base colour's alpha times opacity.
float opacity_at(const Material& material, const glm::vec2& coordinates);

/// Splits the triangles of masked materials until their edges are at most `longest_edge`, or there
/// are `triangle_limit` of them, and takes those away that the mask cuts away for the most part.
/// What is left is masked by pixel where it is drawn.
/// in: mesh and materials of as many vertices
/// Returns whether anything was cut; all may be, and then the mesh has no triangles.
bool cut_masked_away(Mesh& mesh, SurfaceMaterials& materials, float longest_edge,
                     std::size_t triangle_limit = 60'000);

}  // namespace penumbra::prt
#pragma GCC visibility pop
