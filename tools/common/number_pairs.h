// Pairs of numbers on the command line: sizes of light maps, shards.
#pragma once

#include <array>
#include <string>

#include "core/result.h"

namespace penumbra::tools {

/// Two numbers with a sign between them; false where the text is not that.
bool read_pair(const std::string& text, char sign, int& a, int& b);
/// "WIDTHxHEIGHT" within 8..4096.
/// errors: kInvalid
Result<std::array<int, 2>> read_map_size(const std::string& option, const std::string& text);

}  // namespace penumbra::tools
