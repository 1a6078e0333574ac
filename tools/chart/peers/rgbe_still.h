// The dissertation's first coder of HDR pictures, kept for comparison: a picture in RGBE is split
// into a base of three times eight bits, coded like JPEG, and an exponent, coded without loss.
// threads: free functions reentrant
#pragma once

#include <span>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/result.h"

namespace penumbra::tools {

enum class RgbeBase {
  kLossless,
  kJpeg,          // one table of steps for all blocks
  kAdaptiveJpeg,  // finer where exponents differ (AJPEG)
};

/// in:     linear pixels, none negative (they are 0); quality 1..100 as JPEG's, for kLossless none
/// errors: kInvalid (empty, beyond 64 megapixels, values beyond RGBE's, quality)
/// source: Xu 2005, section 4.1: RGBE 4.2 and 4.3 (rounded, where those cut and add half a step),
///         tables 4.5, adaptive steps 4.7; colours at half resolution. Bits go through our range
///         coder, which adapts as the CABAC of the dissertation does. Without loss, a base is
///         predicted from its neighbours' light, which the dissertation names as what its coder
///         left out.
Result<std::vector<unsigned char>> encode_rgbe_still(const Image<Rgb>& picture, RgbeBase base,
                                                     int quality);

/// errors: kUnreadable (damaged)
Result<Image<Rgb>> decode_rgbe_still(std::span<const unsigned char> bytes, const std::string& name);

}  // namespace penumbra::tools
