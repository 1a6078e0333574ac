#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "calib/estimate/boards.h"
#include "calib/track/board_pdf.h"
#include "core/io/files.h"
#include "tools/calibrate/commands.h"
#include "tools/common/command.h"

namespace penumbra::tools {

namespace {

struct CalibrateBoardOptions {
  std::string board = "charuco:8x6:0.03:0.022", paper = "a4", output;
};

Result<void> print_board(const CalibrateBoardOptions& o) {
  if (!o.output.ends_with(".pdf"))
    return fail(ErrorCode::kInvalid, o.output, "does not end in .pdf, which is what a board is");
  PENUMBRA_ASSIGN(board, calib::parse_board(o.board));
  PENUMBRA_ASSIGN(paper, calib::parse_paper(o.paper));
  PENUMBRA_ASSIGN(page, calib::board_pdf(board, paper));
  PENUMBRA_TRY(write_bytes(o.output, page));
  fmt::print(
      "{}: print it at 100 %, measure the ruler of 100 mm, and glue the page to something flat\n",
      o.output);
  return {};
}

}  // namespace

void add_calibrate_board(CLI::App& parent, Action& action) {
  static CalibrateBoardOptions board;
  auto* c = parent.add_subcommand(
      "board", "Write a calibration board as a page to print, in true size with a ruler");
  c->add_option("--board", board.board, kBoardHelp)->capture_default_str();
  c->add_option("--paper", board.paper, "Size of the page: a4 or letter")->capture_default_str();
  c->add_option("-o,--output", board.output, "Page to write, .pdf")->required();
  c->callback([&] { action = [] { return print_board(board); }; });
}

}  // namespace penumbra::tools
