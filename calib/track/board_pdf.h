// Calibration boards as pages to print.
// threads: reentrant
#pragma once

#include <string>
#include <string_view>

#include "calib/estimate/boards.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

enum class Paper { kA4, kLetter };

/// "a4" or "letter".
/// errors: kInvalid naming both
Result<Paper> parse_paper(std::string_view name);

/// As `--board` takes it: "charuco:8x6:0.03:0.022".
std::string board_text(const Board& board);

/// A page in true size, in the better of both directions: the board as one black shape, a ruler of
/// 100 mm, how to check the scale, and what to give as `--board`.
/// out:    PDF 1.4
/// errors: kInvalid (does not fit the paper, with the sizes)
/// source: ISO 32000-1
Result<std::string> board_pdf(const Board& board, Paper paper);

}  // namespace penumbra::calib
#pragma GCC visibility pop
