// Adds each command to the table of arguments; the one that is asked for becomes `action`.
#pragma once

#include "tools/common/command.h"

namespace penumbra::tools {

void add_hdr_merge(CLI::App& parent, Action& action);
void add_hdr_environment(CLI::App& parent, Action& action);
void add_inspect(CLI::App& parent, Action& action);
void add_light_estimate(CLI::App& parent, Action& action);
void add_bake(CLI::App& parent, Action& action);
void add_render(CLI::App& parent, Action& action);
void add_composite(CLI::App& parent, Action& action);
void add_serve(CLI::App& parent, Action& action);
void add_tonemap(CLI::App& parent, Action& action);
void add_encode(CLI::App& parent, Action& action);
void add_decode(CLI::App& parent, Action& action);
void add_record(CLI::App& parent, Action& action);

}  // namespace penumbra::tools
