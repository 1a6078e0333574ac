// What the format files of this folder share; not for other folders.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <string>

#include "codec/codec.h"
#include "core/conventions.h"

namespace penumbra::codec {

using Bytes = std::span<const unsigned char>;

bool is_exr(Bytes bytes);
bool is_radiance(Bytes bytes);

/// OpenEXR or Radiance by content; `name` stands in errors.
/// errors: as read_hdr
Result<HdrImage> decode_hdr(Bytes bytes, const std::string& name);
Result<HdrImage> decode_exr(Bytes bytes, const std::string& name);

/// Radiance file; the picture must not be empty.
std::string encode_radiance(const Image<Rgb>& pixels);

/// The one place where the limits of codec.h are applied.
/// errors: kInvalid, kUnreadable (no area)
inline Result<void> check_size(std::int64_t width, std::int64_t height, const std::string& name) {
  if (width <= 0 || height <= 0) return fail(ErrorCode::kUnreadable, name, "has no pixels");
  if (width > kMaxSide || height > kMaxSide || static_cast<std::size_t>(width * height) > kMaxArea)
    return fail(ErrorCode::kInvalid, name,
                "picture of " + std::to_string(width) + " x " + std::to_string(height) +
                    " pixels is too large");
  return {};
}

inline std::size_t count_non_finite(std::span<const Rgb> pixels) {
  return static_cast<std::size_t>(
      std::ranges::count_if(pixels, [](const Rgb& p) { return !is_finite(p); }));
}

}  // namespace penumbra::codec
