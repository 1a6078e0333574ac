// Manual page and shell completion, made from the options that --help shows.
#pragma once

#include <span>
#include <string>

#include "tools/common/command.h"

namespace penumbra::tools {

/// A manual page in troff's man macros; `siblings` under SEE ALSO.
std::string manual_page(const CLI::App& app, const std::string& version,
                        std::span<const Sibling> siblings = {});

/// A completion script for bash: commands and flags, file names after a flag that takes a value,
/// and a sibling's own completion after its command.
std::string bash_completion(const CLI::App& app, std::span<const Sibling> siblings = {});

}  // namespace penumbra::tools
