// Error against time: our settings one by one, what the governor takes, and what others do.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "tools/chart/charts/chart_environments.h"
#include "tools/chart/charts/chart_options.h"
#include "tools/chart/charts/chart_plot.h"

namespace penumbra::tools {

/// Rays of a bake, a vertex and a receiver texel, where the bake is not what is charted.
inline constexpr int kBakeRays = 1024;

/// Measures each asset in each environment against one reference each, and prints each point unless
/// JSON is asked for.
/// errors: as ChartScene::make, trace_truth and measure
Result<std::vector<ChartPoint>> chart_lights(const ChartOptions& options,
                                             std::span<const std::string> assets,
                                             std::span<const ChartEnvironment> environments);

}  // namespace penumbra::tools
