// A bracket as the commands name it: picture files and their exposure times.
#pragma once

#include <string>
#include <vector>

#include "capture/capture.h"
#include "core/result.h"

namespace penumbra::service {

/// `times`: seconds separated by commas, 1/60 works. Response, noise and black level stay at their defaults.
/// errors: kNotFound, kUnreadable, kInvalid (a time, sizes, bit depths)
/// A time of "?" is left at kUnknownTime where `unknown_allowed`.
Result<capture::ExposureStack> read_bracket(const std::vector<std::string>& images,
                                            const std::string& times, bool unknown_allowed = false);
inline constexpr Seconds kUnknownTime{0};

/// An exposure against the one before it (of those that are told, by time), by what both pictures show.
struct CheckedTime {
  std::size_t picture, against;  // in the stack
  capture::ExposureRatio ratio;
  double told = 0;  // ratio by the given times; 0: it was not given
};
/// Finds unknown times from the nearest known neighbours in the list and compares the told ones. Needs the response.
/// errors: kUndetermined (no time given at all, or no overlap to find an unknown one), kInvalid (not 8 bits)
Result<std::vector<CheckedTime>> check_times(capture::ExposureStack& stack);

/// What a stack of 8-bit frames holds, for those who estimate a response.
struct EightBitBracket {
  std::vector<const Image<Rgb8>*> pictures;  // live as long as the stack
  std::vector<Seconds> times;
};
EightBitBracket eight_bit_bracket(const capture::ExposureStack& stack);

}  // namespace penumbra::service
