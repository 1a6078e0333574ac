// Sizes of light maps on the command line.
#pragma once

#include <array>
#include <string>

#include "core/result.h"

namespace penumbra::tools {

/// "WIDTHxHEIGHT" within 8..4096.
/// errors: kInvalid
Result<std::array<int, 2>> read_map_size(const std::string& option, const std::string& text);

}  // namespace penumbra::tools
