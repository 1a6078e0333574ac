// Pictures of glTF files, decoded.
// threads: reentrant
#pragma once

#include <span>
#include <string>

#include "core/result.h"
#include "prt/geometry/material.h"

namespace penumbra::prt::gltf {

/// Larger pictures are refused: their codes alone would take a quarter of a gigabyte.
inline constexpr std::size_t kMaxPicturePixels = std::size_t{64} << 20;

/// PNG or JPEG, by content, with its alpha. `whose` begins the messages, which do not tell the
/// file.
/// errors: kInvalid (too large; KTX2, WebP and other kinds), kUnreadable (damaged)
Result<TexturePicture> decode_picture(std::span<const unsigned char> bytes, const std::string& file,
                                      const std::string& whose);

}  // namespace penumbra::prt::gltf
