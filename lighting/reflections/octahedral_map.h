// A square picture of all directions: the octahedron, its lower half folded outwards.
// source: Praun & Hoppe 2003
// threads: reentrant
#pragma once

#include <glm/vec2.hpp>
#include <glm/vec3.hpp>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// Unit direction of a place, 0..1 from the first column and row: straight up in the middle,
/// straight down in the four corners, x to the right, z down.
glm::vec3 octahedral_direction(const glm::vec2& place);
/// in:  not zero
glm::vec2 octahedral_place(const glm::vec3& direction);
/// The texel that stands for one at most one beside the picture, where it goes on across the fold.
glm::ivec2 octahedral_texel(int x, int y, int size);
/// Between the four nearest texels, across the folds too.
Rgb sample_octahedral(const Image<Rgb>& picture, const glm::vec3& direction);

}  // namespace penumbra::lighting
#pragma GCC visibility pop
