// The live service: cameras, light, composite, HTTP.
// threads: one call at a time in a process, whose stop signals it takes over
#pragma once

#include <optional>
#include <string>

#include "core/result.h"
#include "service/quick_rig.h"
#include "service/rig_source.h"

namespace penumbra::service {

struct ServeOptions {
  std::string config;               // rig.toml, or
  std::optional<QuickStart> quick;  // what is on the table
};
/// Runs until it is stopped by SIGINT or SIGTERM.
/// errors: as read_rig_config, open_rig, prepare; kUnavailable (the port is taken)
Result<void> serve(const ServeOptions& options, const ProgressOf& progress);

}  // namespace penumbra::service
