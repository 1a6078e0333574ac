// Adds each command to the table of arguments; the one that is asked for becomes `action`.
#pragma once

#include "tools/common/command.h"

namespace penumbra::tools {

void add_compare(CLI::App& parent, Action& action);
void add_chart(CLI::App& parent, Action& action);

}  // namespace penumbra::tools
