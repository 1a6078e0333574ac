// A bracket as the commands name it: picture files and their exposure times.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "capture/hdr/merge.h"
#include "capture/hdr/stacks.h"
#include "core/result.h"

namespace penumbra::tools {

/// `times`: seconds separated by commas, 1/60 works; empty: as the cameras wrote into the JPEGs
/// (EXIF), for the ISO of the first picture. Response, noise and black level stay at their
/// defaults. A time of "?" is left at kUnknownTime where `unknown_allowed`.
/// errors: kNotFound, kUnreadable, kInvalid (a time, sizes, bit depths, apertures that differ),
///         kUndetermined (no time)
Result<capture::ExposureStack> read_bracket(const std::vector<std::string>& images,
                                            const std::string& times, bool unknown_allowed = false);
inline constexpr Seconds kUnknownTime{0};

/// Captures of one still scene by one camera as a bracket: the frames of each exposure time and
/// gain averaged, which takes the noise and, over some seconds, the mains' flicker out.
/// errors: as capture::open_capture; kNotFound (no such camera), kUndetermined (fewer than two
/// exposures, more than 16), kInvalid (sizes, not 8 bits)
Result<capture::ExposureStack> average_clips(const std::vector<std::string>& captures,
                                             const std::string& camera);

/// How far the camera moved between two pictures that follow each other by exposure.
struct MovedCamera {
  std::size_t picture, against;  // in the stack
  double moved_px;
};
/// What all pictures (8 bits) show, shifted onto each other, for those who compare them: where the
/// camera was held by hand. `moved` tells the largest shift; nothing where it stood still, or the
/// pictures tell nothing.
struct CommonPart {
  capture::ExposureStack stack;
  MovedCamera moved;
};
std::optional<CommonPart> common_part(const capture::ExposureStack& stack);

/// An exposure against the one before it (of those that are told, by time), by what both pictures
/// show.
struct CheckedTime {
  std::size_t picture, against;  // in the stack
  capture::ExposureRatio ratio;
  double labelled_ratio = 0;  // ratio by the given times; 0: it was not given

  /// What was told lies outside of the interval and a tenth off, where at least such a fraction of
  /// the pictures tells. Less may be a border, or haze in a lens.
  bool contradicts_label(double fraction) const;
};
/// Finds unknown times from the nearest known neighbours in the list and compares the told ones.
/// Needs the response; `exponent_sigma` as for capture::estimate_exposure_ratio.
/// in:     frames of one kind
/// errors: kUndetermined (no time given at all, no overlap to find an unknown one, or so little
///         that the curve decides)
Result<std::vector<CheckedTime>> check_times(capture::ExposureStack& stack, double exponent_sigma);

/// What a stack of 8-bit frames holds, for those who estimate a response.
struct EightBitBracket {
  std::vector<const Image<Rgb8>*> pictures;  // live as long as the stack
  std::vector<Seconds> times;
};
EightBitBracket eight_bit_bracket(const capture::ExposureStack& stack);

}  // namespace penumbra::tools
