// A JPEG that old viewers show as it is and new ones with its highlights: a gain map.
// threads: reentrant
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "codec/codec.h"
#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::codec {

/// A base and the gains from it to the radiance, in a file of two pictures (CIPA DC-007), described
/// both as Adobe's XMP and as ISO 21496-1. The gains undo what JPEG does to the base. Where half of
/// the picture is above and half below there is no gain. The factor between radiance and that is
/// in the file.
/// in:     linear Rec.709, components below 0 count as 0; base: sRGB, of the same size, as a tone
///         mapper makes it. The darkest thousandth of the values may come back brighter, and what
///         is above 2^48 times white darker.
/// errors: kInvalid (empty, another size), kNonFinite (first bad pixel)
/// source: Adobe, "Gain Map Specification" 1.0, section "Encode"
Result<std::vector<unsigned char>> encode_gain_map_jpeg(const Image<Rgb>& radiance,
                                                        const Image<Rgb8>& base, int quality = 90);

/// Whether decode_gain_map_jpeg() finds a gain map in it.
bool has_gain_map(std::span<const unsigned char> jpeg);

/// Radiance as it was given to the encoder; of files by others in multiples of the base's white.
/// A base in other primaries than Rec.709 comes with an ICC profile, and is converted.
/// errors: kUnreadable (no gain map, damaged), kInvalid (too large, the base is the brighter one,
///         gains in other primaries than the base's)
Result<HdrImage> decode_gain_map_jpeg(std::span<const unsigned char> jpeg, const std::string& name);

/// A picture as it is to be looked at: as read_frame(), but of a JPEG with a gain map its radiance,
/// where that can be had.
/// errors: as read_frame
Result<FramePixels> read_picture(const std::filesystem::path& path);

}  // namespace penumbra::codec
#pragma GCC visibility pop
