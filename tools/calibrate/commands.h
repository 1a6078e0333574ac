// Adds each command to the table of arguments; the one that is asked for becomes `action`.
#pragma once

#include "tools/common/command.h"

namespace penumbra::tools {

inline constexpr const char* kBoardHelp =
    "Calibration board, lengths in metres: chessboard:15x9:0.026 (inner corners, side of a "
    "square), "
    "charuco:8x6:0.04:0.03 (squares, side of a square, side of a marker) or "
    "apriltag:6x5:0.05:0.015 (tags, side of a tag, gap between tags)";

void add_calibrate_response(CLI::App& parent, Action& action);
void add_calibrate_board(CLI::App& parent, Action& action);
void add_calibrate_camera(CLI::App& parent, Action& action);
void add_calibrate_vignetting(CLI::App& parent, Action& action);
void add_calibrate_ball(CLI::App& parent, Action& action);
void add_calibrate_noise(CLI::App& parent, Action& action);
void add_calibrate_rig(CLI::App& parent, Action& action);
void add_calibrate_latency(CLI::App& parent, Action& action);
void add_calibrate_colour(CLI::App& parent, Action& action);
void add_calibrate_import(CLI::App& parent, Action& action);

}  // namespace penumbra::tools
