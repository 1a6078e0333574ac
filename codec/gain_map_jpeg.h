// A JPEG that old viewers show as it is and new ones with its highlights: a gain map.
// threads: reentrant
#pragma once

#include <vector>

#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::codec {

/// Adobe's gain map with its XMP metadata, in a file of two pictures (CIPA DC-007). The base keeps
/// hues: all channels of a pixel are brought down alike.
/// in:     linear Rec.709, finite; exposure: times radiance, 1 is the white of a screen
/// errors: kInvalid (empty)
/// source: Adobe, "Gain Map Specification" 1.0, section "Encode"; gains are those of the largest
///         channel
Result<std::vector<unsigned char>> encode_gain_map_jpeg(const Image<Rgb>& pixels, float exposure,
                                                        int quality = 90);

}  // namespace penumbra::codec
#pragma GCC visibility pop
