// The demo's options and what it does with them.
#pragma once

#include "tools/common/command.h"

namespace penumbra::tools {

void add_demo(CLI::App& app, Action& action);

}  // namespace penumbra::tools
