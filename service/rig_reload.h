// What rig.toml says otherwise than before.
// threads: reentrant
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace penumbra::service {

/// Keys that only one of the texts has, or that have another value there, by their places:
/// "light.bands", "camera[1].fps", "pose".
/// errors: kUnreadable (line); `path` names the texts in errors
Result<std::vector<std::string>> changed_keys(std::string_view before, std::string_view now,
                                              const std::filesystem::path& path);

}  // namespace penumbra::service
