// The summary of a run, the same for demo, composite and summary.json.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "core/threads/stage_times.h"
#include "runtime/pipeline/runs.h"

namespace penumbra::tools {

struct Configuration {
  int bands = 0, width = 0, height = 0, objects = 0;
  std::string renderer;
};

nlohmann::json summarise(const runtime::RunCounts& counts, const StageTimes& times,
                         const Configuration& configuration);
/// A table for people.
void print_summary(const nlohmann::json& summary);

}  // namespace penumbra::tools
