// What a baked object takes in memory, as `bake` and `inspect` say it.
#pragma once

#include <nlohmann/json.hpp>

#include "prt/bake/bake.h"

namespace penumbra::tools {

/// Of the object on a grey floor: what a bake keeps apart for floors of any albedo is summed there.
nlohmann::json report_memory(const prt::BakedObject& baked);

}  // namespace penumbra::tools
