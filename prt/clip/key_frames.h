// Where a clip's key frames stand, and how far a straight line between two of them is off.
// threads: reentrant; plain values
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "prt/transfer/transfer.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

struct Transfer;

/// Key frame i stands at at[i]/parts of the clip; at[0] is 0, they rise. After the last one the
/// clip begins anew.
struct KeyFrames {
  // Parts at most of what lies between two frames of the rate asked for
  static constexpr std::uint32_t kMaxParts = 8;
  std::uint32_t parts = 1;
  std::vector<std::uint32_t> at{0};

  /// To the next key frame, in parts; of the last one to the clip's end.
  std::uint32_t width(std::size_t frame) const {
    return (frame + 1 < at.size() ? at[frame + 1] : parts) - at[frame];
  }
  /// The key frame before a time and the fraction of the way to the next; one clip later is
  /// at.size() frames later.
  double frame_at(double clips) const;
};

/// By interval from key frame i on: what linear interpolation across it leaves out, RMS over a
/// sample of the points under light of mean_band_energy, absolute: h^2/4 max |t''|, t'' from
/// divided differences at both ends. That is twice the bound for smooth functions: visibility comes
/// and goes at once, so halving h halves the error (the walker at 15 and 30 frames a
/// second: at worst 3.5 and 1.6 %, told 4.1 and 2.3; with an eighth 2.0 and 1.2). Infinite where
/// key frames are too few to tell (fewer than four).
/// source: error of linear interpolation, e.g. Burden & Faires 2011, theorem 3.3
std::vector<double> interpolation_errors(const KeyFrames& keys, std::span<const Transfer> frames);

/// What interpolation may err by, relative, given what is asked for and the bake's standard error:
/// a quarter of that no further frames mend (its pattern is the same in all frames, so it hardly
/// bends).
inline double allowed_interpolation_error(double asked, double standard_error) {
  return std::max(asked, .25 * standard_error);
}

}  // namespace penumbra::prt
#pragma GCC visibility pop
