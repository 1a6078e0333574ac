// A picture's exponents and bases of the DCT scheme as bits; not for other folders.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "codec/dct/rgbe_still.h"
#include "core/image.h"

namespace penumbra::codec {

/// Steps of JPEG's tables, from one where a coarseness is this.
inline constexpr float kTableCoarseness = 64;

/// Bases as RGBE has them, exponents before them: any base but kContinuous.
/// in:     no component below 0, all finite and below 2^126
std::vector<unsigned char> write_split_bases(const Image<Rgb>& picture, const RgbeCoding& coding);
Image<Rgb> read_split_bases(std::span<const unsigned char> bytes, int width, int height,
                            const RgbeCoding& coding);

/// kContinuous: logarithms of luminance, which go on where exponents step, colours at half
/// resolution, and exponents as they differ from what these let expect. All that later bits depend
/// on is in whole numbers: a reader on another machine computes the same.
/// in:     as write_split_bases; a coarseness is a step of a 4096th of a stop
std::vector<unsigned char> write_continuous_base(const Image<Rgb>& picture, int coarseness);
Image<Rgb> read_continuous_base(std::span<const unsigned char> bytes, int width, int height,
                                int coarseness);

}  // namespace penumbra::codec
