// A lat-long map at a fraction of its size, with all of its light.
// threads: reentrant, parallel inside
#pragma once

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// Whether blocks of so many pixels squared make a map of at least 64 rows and a width that is a
/// multiple of 4.
bool divides_into_blocks(const Image<Rgb>& map, int side);

/// Means of blocks of pixels, weighted by solid angle.
/// in:  side: one that divides_into_blocks
/// out: keeps its memory
void average_blocks(const Image<Rgb>& map, int side, Image<Rgb>& out);

}  // namespace penumbra::lighting
#pragma GCC visibility pop
