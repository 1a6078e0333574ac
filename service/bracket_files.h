// A bracket as the commands name it: picture files and their exposure times.
#pragma once

#include <string>
#include <vector>

#include "capture/capture.h"
#include "core/result.h"

namespace penumbra::service {

/// `times`: seconds separated by commas, 1/60 works. Response, noise and black level stay at their defaults.
/// errors: kNotFound, kUnreadable, kInvalid (a time, sizes, bit depths)
Result<capture::ExposureStack> read_bracket(const std::vector<std::string>& images,
                                            const std::string& times);

/// What a stack of 8-bit frames holds, for those who estimate a response.
struct EightBitBracket {
  std::vector<const Image<Rgb8>*> pictures;  // live as long as the stack
  std::vector<Seconds> times;
};
EightBitBracket eight_bit_bracket(const capture::ExposureStack& stack);

}  // namespace penumbra::service
