// What the shards of a clip's bake ask of a queue: by baking one frame here.
// threads: reentrant, parallel inside
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/result.h"
#include "prt/clip/sequence.h"
#include "tools/farm/slurm_script.h"

namespace penumbra::tools {

/// What one task with its cores comes to.
struct ClipEstimate {
  int frames = 0;  // of the rate asked for
  double frame_s = 0;
  std::uint64_t frame_bytes = 0;  // of a journal
  std::uint64_t task_bytes = 0;   // of memory, to bake any frame
};

/// cores: of a task, at least 1
/// errors: as prt::estimate_work
Result<ClipEstimate> estimate_clip(const prt::Character& character, int clip,
                                   const prt::SequenceOptions& options, int cores);

/// So many shards that each takes about ten minutes: 1..64, no more than frames.
int shards_for(const ClipEstimate& estimate);

/// The array of a round, 0: of the frames of the rate. `arguments` are the program's without
/// --shard and --round.
SlurmStage clip_array(const ClipEstimate& estimate, std::vector<std::string> arguments, int shards,
                      int round);
/// What joins them, of at most `frames` frames.
SlurmStage clip_merge(const ClipEstimate& estimate, std::vector<std::string> arguments, int shards,
                      int frames);

}  // namespace penumbra::tools
