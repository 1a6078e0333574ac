// Radiance in JPEG 2000: logarithms of luminance, and colour, as whole numbers under wavelets.
// threads: reentrant
#pragma once

#include <optional>
#include <span>
#include <string>

#include "codec/codec.h"
#include "codec/still_goal.h"
#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::codec {

enum class WaveletCoder {
  kFast,   // ISO/IEC 15444-15: a .jph. With a side below 64 pixels: as kSmall
  kSmall,  // ISO/IEC 15444-1: a .jp2, a tenth smaller, several times as slow to write
};

/// A JP2 or JPH file: three planes, CIE luminance in equal steps of its logarithm and CIE 1976
/// u', v' as sYCC, so that other readers show a pale picture; a box of our own says the steps.
/// in:     linear Rec.709. Components below 0 come back as 0 at the pixel's luminance, or, where it
///         has none, at that of the others. What is darker than 2^-28 of the brightest pixel counts
///         as black, which comes back black, but for its neighbours' ringing. No alpha.
/// errors: kInvalid (empty, too large, a pixel above 1e30, a goal out of its range), kNonFinite,
///         kUndetermined (the goal cannot be met)
/// source: Xu 2005, section 4.2. Differs: one logarithm of luminance and u', v' in place of three
///         of RGB, which takes a fifth less at one error of luminance
Result<CodedStill> encode_log_jpeg2000(const Image<Rgb>& radiance, const StillGoal& goal = {},
                                       WaveletCoder coder = WaveletCoder::kFast,
                                       std::optional<EnvironmentAttribute> environment = {});

/// No pixel's log10 luminance farther off than `goal.deviation`, nor any channel's light: as few
/// bits as that allows, and wavelets of whole numbers. Colour is in steps alike.
/// errors: as encode_log_jpeg2000; kInvalid where goal.max_bytes is said
/// source: Xu 2005, equations 9.8 to 9.11
Result<CodedStill> encode_log_jpeg2000_exactly(
    const Image<Rgb>& radiance, const StillGoal& goal, WaveletCoder coder = WaveletCoder::kFast,
    std::optional<EnvironmentAttribute> environment = {});

/// Whether the bytes begin as a JP2 or JPH file does.
bool is_jpeg2000(std::span<const unsigned char> bytes);

/// Components that rounding takes below 0 are 0.
/// errors: kUnreadable (damaged, truncated, not written by encode_log_jpeg2000), kInvalid (too
///         large, or larger than so few bytes can tell)
Result<HdrImage> decode_log_jpeg2000(std::span<const unsigned char> bytes, const std::string& name);

}  // namespace penumbra::codec
#pragma GCC visibility pop
