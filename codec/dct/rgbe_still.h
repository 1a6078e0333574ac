// Radiance by cosines: a picture as RGBE, whose exponents are kept without loss and whose bases are
// coded like JPEG.
// threads: reentrant
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "codec/codec.h"
#include "codec/still_goal.h"
#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::codec {

enum class RgbeBase : std::uint8_t {
  kLossless,
  kJpeg,          // one table of steps for all blocks
  kAdaptiveJpeg,  // finer where exponents differ (AJPEG)
  kContinuous,    // goes on where exponents step: about half of kAdaptiveJpeg's bytes
};

/// coarseness: 1..65535. kContinuous: the step in a 4096th of a stop; JPEG's: 64 for its tables as
/// they are printed; kLossless: 0
struct RgbeCoding {
  RgbeBase base = RgbeBase::kContinuous;
  int coarseness = 0;
};

/// A .pnr file, the smallest within a goal.
/// in:     linear Rec.709. Components below 0 come back as 0 at the pixel's luminance. Black stays
///         black, and so does what is darker than 2^-127. No alpha.
///         base: any but kLossless
/// errors: kInvalid (empty, too large, a pixel above 1e30, a goal out of its range, the base),
///         kNonFinite, kUndetermined (the goal cannot be met)
/// source: Xu 2005, section 4.1: RGBE 4.2 and 4.3 (rounded, where those cut and add half a step),
///         tables 4.5, adaptive steps 4.7; colours at half resolution. Bits go through our range
///         coder, which adapts as the CABAC of the dissertation does. kContinuous differs, as said
///         in docs/methods/still-coding.md
Result<CodedStill> encode_rgbe_still(const Image<Rgb>& radiance, const StillGoal& goal = {},
                                     RgbeBase base = RgbeBase::kContinuous,
                                     std::optional<EnvironmentAttribute> environment = {});

/// With the steps as said. kLossless: what RGBE keeps, each base predicted from its neighbours'
/// light, which the dissertation names as what its coder left out.
/// errors: as encode_rgbe_still; kInvalid (a coarseness out of its range)
Result<CodedStill> encode_rgbe_still_as(const Image<Rgb>& radiance, const RgbeCoding& coding,
                                        std::optional<EnvironmentAttribute> environment = {});

/// Whether the bytes begin as a .pnr file does.
bool is_rgbe_still(std::span<const unsigned char> bytes);

/// errors: kUnreadable (damaged, truncated), kInvalid (too large, or larger than so few bytes can
///         tell)
Result<HdrImage> decode_rgbe_still(std::span<const unsigned char> bytes, const std::string& name);

}  // namespace penumbra::codec
#pragma GCC visibility pop
