// Radiance as three codes of 12 bits: how bright, on a logarithmic scale, and which colour. A video
// coder's errors in them are relative ones, alike in the sun and in the shade.
// threads: every function is reentrant
#pragma once

#include <cstdint>
#include <span>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::codec {

inline constexpr int kLogLuvBits = 12;

/// The codes of some pixels, as planes of equal length.
template <class Code>
struct LogLuvPlanes {
  std::span<Code> l, u, v;
};

/// Of this much of grey more than there is, so that noise in the dark costs no bits: far above it
/// errors are relative ones, far below it they are fractions of it.
inline constexpr float kLogLuvToe = 1.f / 64;

/// Brightness in steps of 1/128 stop above the toe, up to 2^26; colour in steps of 1/6400 of CIE
/// 1976 u', v'. What is negative or NaN counts as 0.
/// in:     values, linear Rec.709, in a scale of which the mean is about 1; as many as codes
/// source: Ward Larson 1998, "The LogLuv Encoding for Full Gamut, High Dynamic Range Images", whose
///         scales these are with other numbers of steps; the toe is ours
void log_luv_from_rgb(std::span<const Rgb> values, const LogLuvPlanes<std::uint16_t>& out);

/// Within .3 % of brightness and toe; channels that rounding takes below 0 are 0.
void rgb_from_log_luv(const LogLuvPlanes<const std::uint16_t>& codes, std::span<Rgb> out);

}  // namespace penumbra::codec
#pragma GCC visibility pop
