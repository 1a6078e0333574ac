// Adds each command to the table of arguments; the one that is asked for becomes `action`.
#pragma once

#include "tools/common/command.h"

namespace penumbra::tools {

void add_calibrate_response(CLI::App& parent, Action& action);
void add_calibrate_camera(CLI::App& parent, Action& action);
void add_calibrate_vignetting(CLI::App& parent, Action& action);
void add_calibrate_ball(CLI::App& parent, Action& action);
void add_calibrate_noise(CLI::App& parent, Action& action);
void add_calibrate_rig(CLI::App& parent, Action& action);
void add_calibrate_colour(CLI::App& parent, Action& action);

}  // namespace penumbra::tools
