// Image files: OpenEXR and Radiance HDR in and out, PNG/JPEG/TIFF frames in and out.
// Pixels come back exactly as stored (NaN and infinities too, counted): what to do with them is the
// caller's decision, and environment readers exclude them from the light.
// threads: every function is reentrant
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <vector>

#include "codec/range_coder.h"  // IWYU pragma: export
#include "core/image.h"
#include "core/picture_size.h"  // IWYU pragma: export
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::codec {

/// Larger pictures no reader accepts; checked before anything is allocated.
using penumbra::kMaxSide;
inline constexpr std::size_t kMaxArea = std::size_t{1} << 28;

/// The OpenEXR standard attribute "envmap" (OpenEXR documentation, "Environment Maps").
enum class EnvironmentAttribute { kLatLong, kCube };

struct HdrImage {
  Image<Rgb> pixels;           // linear Rec.709 (converted from the file's chromaticities if other)
  std::size_t non_finite = 0;  // pixels with a NaN or an infinity in any channel
  std::optional<EnvironmentAttribute> environment;  // OpenEXR only
  Image<float> alpha{};  // as stored; empty where the file has none. OpenEXR only
  /// Above 0 where the radiance is a lower bound, by a channel of that name; likewise.
  Image<float> clipped{};
};

/// Reads .exr (RGB, grey, luminance/chroma; scan lines or tiles, level 0; first part) or Radiance
/// .hdr (RGBE or XYZE, old or new run lengths, any orientation, lines before the magic), or a JPEG
/// with a gain map (gain_map_jpeg.h). Kind by content.
/// errors:  kNotFound, kUnreadable (truncated, damaged, no colour channels), kInvalid (too
/// large)
Result<HdrImage> read_hdr(const std::filesystem::path& path);

/// Radiance HDR from memory; `name` stands in errors. For fuzzing and for tests.
Result<HdrImage> decode_radiance(std::span<const unsigned char> bytes, const std::string& name);

enum class Depth { kHalf, kFloat };

/// Writes .exr (ZIP) or .hdr by extension, atomically. .hdr cannot hold negative values: they are
/// 0.
/// in:      alpha, clipped: channels "A" and "clipped" of .exr, written as they are; empty: none
/// errors:  kInvalid (empty, unknown extension, such a channel of another size or in .hdr),
///          kUnwritable
Result<void> write_hdr(const std::filesystem::path& path, const Image<Rgb>& pixels,
                       Depth depth = Depth::kHalf,
                       std::optional<EnvironmentAttribute> environment = std::nullopt,
                       const Image<float>& alpha = {}, const Image<float>& clipped = {});

/// Reads a camera frame by content: 8/16 bit PNG, JPEG, TIFF as RGB codes; EXR/HDR as linear float.
/// Grey becomes three equal channels; alpha is dropped.
/// errors:  as read_hdr
Result<FramePixels> read_frame(const std::filesystem::path& path);

/// The same from memory; `name` stands in errors.
Result<FramePixels> decode_frame(std::span<const unsigned char> bytes, const std::string& name);

struct FrameWithAlpha {
  FramePixels pixels;
  Image<std::uint8_t> alpha{};  // in 8 bits; empty where there is none. PNG only
};
Result<FrameWithAlpha> decode_frame_with_alpha(std::span<const unsigned char> bytes,
                                               const std::string& name);

/// Writes PNG, JPEG or TIFF by extension, atomically.
/// errors:  kInvalid (empty, unknown extension), kUnwritable
Result<void> write_frame(const std::filesystem::path& path, const Image<Rgb8>& pixels);
Result<void> write_frame(const std::filesystem::path& path, const Image<Rgb16>& pixels);

/// JPEG bytes of a picture; quality 1..100.
/// errors: kInvalid (empty)
Result<std::vector<unsigned char>> encode_jpeg(const Image<Rgb8>& pixels, int quality = 90);

}  // namespace penumbra::codec
#pragma GCC visibility pop
