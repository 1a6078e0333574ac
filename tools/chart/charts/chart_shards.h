// A chart of lights in shards: every n-th case, an asset in an environment, apart from the others.
// threads: thread-bound, parallel inside
#pragma once

#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "tools/chart/charts/chart_environments.h"
#include "tools/chart/charts/chart_options.h"
#include "tools/chart/charts/chart_plot.h"
#include "tools/farm/shard_choice.h"

namespace penumbra::tools {

/// Measures the shard's cases into its file in the output folder, whose path comes back. What is
/// there as a whole is not measured again.
/// errors: as chart_lights, kUnwritable, kInvalid (a file of another chart is there)
Result<std::string> chart_shard(const ChartOptions& options, std::span<const std::string> assets,
                                std::span<const ChartEnvironment> environments, ShardChoice shard);

/// The points of all shards, in the order in which one chart measures them.
/// errors: kNotFound, kUnreadable, kInvalid (of another chart), naming the file
Result<std::vector<ChartPoint>> read_chart_shards(const ChartOptions& options,
                                                  std::span<const std::string> assets,
                                                  std::span<const ChartEnvironment> environments,
                                                  int count);

/// Beside which the files of shards stand.
std::string chart_shards_stem(const ChartOptions& options);

}  // namespace penumbra::tools
