// Files that an asset names.
// threads: reentrant
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "core/result.h"

namespace penumbra::prt {

/// A file in the folder of `asset` or below, symbolic links followed. `whose` begins the messages.
/// errors: kInvalid (lies elsewhere), kNotFound, kUnreadable
Result<std::vector<unsigned char>> read_beside(const std::filesystem::path& asset,
                                               const std::string& relative,
                                               const std::string& whose);
/// What a file names, short and in one line, for messages.
std::string shown(const std::string& name);

}  // namespace penumbra::prt
