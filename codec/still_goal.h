// How small a picture that loses something is to be, or how close.
// threads: plain values
#pragma once

#include <cstddef>
#include <vector>

#pragma GCC visibility push(default)
namespace penumbra::codec {

/// The error of log10 luminance, RMS over the pixels that are not black, or that of the logarithm
/// of a channel's sum, whichever is larger: a sun is few pixels and most of the light. .0086: 2 %.
inline constexpr double kStillDeviation = .0086;

/// One of the two: the smallest file whose error is at most `deviation`, or the closest one of at
/// most `max_bytes`, where those are not 0.
struct StillGoal {
  double deviation = kStillDeviation;  // 1e-5..1
  std::size_t max_bytes = 0;
};

/// What a coder made, and how far its picture is from the one that it was given.
struct CodedStill {
  std::vector<unsigned char> bytes;
  double deviation = 0;  // as StillGoal's, of the picture as it decodes
};

}  // namespace penumbra::codec
#pragma GCC visibility pop
