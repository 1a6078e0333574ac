// The clip whose coders are charted, and the journals that hold its frames.
// threads: thread-bound, parallel inside
#pragma once

#include <filesystem>
#include <vector>

#include "core/result.h"
#include "prt/clip/sequence.h"
#include "runtime/scene/animated.h"
#include "tools/chart/charts/chart_options.h"
#include "tools/farm/shard_choice.h"

namespace penumbra::tools {

struct ChartedClip {
  runtime::StandingCharacter standing;
  prt::SequenceOptions options;
};
/// errors: as runtime::standing_character, kInvalid (--light-map)
Result<ChartedClip> charted_clip(const ChartOptions& options);

/// Bakes a shard's frames into its file in the output folder, whose path comes back.
/// errors: as prt::bake_frames
Result<std::string> bake_charted_shard(const ChartOptions& options, const ChartedClip& clip,
                                       ShardChoice shard);
/// Those of --merge, or `whole` with all frames, baked here.
/// errors: as prt::check_shards, as prt::bake_frames
Result<std::vector<std::filesystem::path>> charted_journals(const ChartOptions& options,
                                                            const ChartedClip& clip,
                                                            const std::filesystem::path& whole);

/// Beside which the files of shards stand.
std::string clip_shards_stem(const ChartOptions& options);

}  // namespace penumbra::tools
