// Cube maps as engines load them: KTX.
// threads: reentrant
#pragma once

#include <span>
#include <vector>

#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::codec {

/// RGBA as half floats, alpha 1, one level; above 65504 it is that.
/// in:     linear; faces in the order +x, -x, +y, -y, +z, -z, each row by row, with the axes of
///         OpenGL's cube maps; size: edge of a face in texels
/// errors: kInvalid (not six faces of that size)
/// source: Khronos, "KTX File Format Specification" 1.1
Result<std::vector<unsigned char>> encode_cube_ktx(std::span<const Rgb> texels, int size);

}  // namespace penumbra::codec
#pragma GCC visibility pop
