// How small a picture that loses something is to be, or how close.
// threads: plain values
#pragma once

#include <cstddef>
#include <vector>

#pragma GCC visibility push(default)
namespace penumbra::codec {

/// One of the two: the smallest file whose error is at most `deviation`, or the closest one of at
/// most `max_bytes`, where those are not 0. The error is the larger of StillError's first two.
struct StillGoal {
  double deviation = .0086;  // 1e-5..1; 2 %
  std::size_t max_bytes = 0;
};

/// Of a picture as it decodes; all are of logarithms to base 10.
struct StillError {
  double luminance_rms = 0, luminance_max = 0;  // over the pixels that are not black
  /// The largest of the sums of the channels, of which each counts as a twentieth of the brightest
  /// one more: a sun is few pixels and most of the light. A picture twice as wide as high is taken
  /// for a lat-long map, whose sums are over the sphere.
  double light = 0;
  std::size_t negative = 0;  // pixels of the truth with components below 0

  double larger() const { return luminance_rms > light ? luminance_rms : light; }
};

struct CodedStill {
  std::vector<unsigned char> bytes;
  StillError error;
};

}  // namespace penumbra::codec
#pragma GCC visibility pop
