// What `penumbra inspect` says of a mesh file.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "core/result.h"

namespace penumbra::tools {

/// errors: as prt::import_mesh
Result<nlohmann::json> inspect_mesh(const std::string& file);

}  // namespace penumbra::tools
