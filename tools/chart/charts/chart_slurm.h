// A chart on Slurm: what its jobs run and ask for.
// threads: thread-bound
#pragma once

#include <cstddef>

#include "core/result.h"
#include "tools/chart/charts/chart_options.h"
#include "tools/chart/charts/clip_setup.h"

namespace penumbra::tools {

/// Of lights, so many cases.
/// errors: as print_or_run
Result<void> chart_on_slurm(const ChartOptions& options, std::size_t cases);
/// Of a clip's coders.
/// errors: as estimate_clip and print_or_run
Result<void> chart_clip_on_slurm(const ChartOptions& options, const ChartedClip& clip);

}  // namespace penumbra::tools
