// JPEG XL by libjxl; not for other folders.
#pragma once

#include <span>
#include <vector>

#include "core/image.h"
#include "core/result.h"

namespace penumbra::tools {

/// Linear floats; distance as libjxl has it, 1 is what an eye just tells.
/// errors: kUnwritable
Result<std::vector<unsigned char>> encode_jpeg_xl(const Image<Rgb>& picture, float distance);
/// errors: kUnreadable
Result<Image<Rgb>> decode_jpeg_xl(std::span<const unsigned char> bytes);

}  // namespace penumbra::tools
