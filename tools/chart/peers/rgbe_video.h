// The dissertation's coder for sequences of HDR maps, kept for comparison: each value is split as
// in RGBE into a base of eight bits and an exponent, bases are coded like motion JPEG, exponents
// without loss.
// threads: free functions reentrant
#pragma once

#include <span>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/result.h"

namespace penumbra::tools {

/// Maps of one value a pixel, all of one size. RGBE cannot hold negative values: the dissertation
/// drops them; here signs are a plane of their own, coded without loss.
/// in:     quality 1..100 as JPEG's; every `key_interval`-th map is coded by itself, others by
///         motion-compensated differences (16x16 blocks, 7 pixels around)
/// errors: kInvalid (no maps, sizes that differ, larger than 4096, values beyond RGBE's)
/// source: Xu 2005, chapter 4: RGBE 4.2 to 4.3, adaptive quantisation 4.6 and 4.7 (a block's
///         quantiser divided by floor((largest - smallest exponent + 3)/2)). Bits go through our
///         range coder instead of Huffman tables, which flatters the result.
Result<std::vector<unsigned char>> encode_rgbe_video(std::span<const Image<float>> maps,
                                                     int quality, int key_interval = 10);

/// errors: kUnreadable (damaged), kInvalid (too large)
Result<std::vector<Image<float>>> decode_rgbe_video(std::span<const unsigned char> bytes,
                                                    const std::string& name);

}  // namespace penumbra::tools
