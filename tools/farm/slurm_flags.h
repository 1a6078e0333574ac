// What commands that run on Slurm share: their flags, and what they do with a plan.
// threads: thread-bound
#pragma once

#include <string>

#include "core/result.h"
#include "tools/farm/slurm_job.h"
#include "tools/farm/slurm_script.h"

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace penumbra::tools {

struct SlurmFlags {
  bool slurm = false, print = false;
  int shards = 0;  // 0: by the estimate
  int cores = 4;   // of each task
  // Asked for, of each task; 0: by the estimate
  int memory_mb = 0, minutes = 0;
};

/// --slurm and what needs it; the option --slurm comes back. by_default: of --shards.
CLI::Option* add_slurm_flags(CLI::App& command, SlurmFlags& flags, const std::string& by_default);

/// A plan without stages: this very program, in this folder, with its logs beside `output`.
/// errors: kUnavailable (the machine does not tell)
Result<SlurmPlan> begin_plan(const std::string& output, const SlurmFlags& flags);

/// Prints the script, or runs it and tells what became of it. Memory and time are the flags' where
/// those say some.
/// errors: as slurm_script and run_on_slurm
Result<void> print_or_run(SlurmPlan plan, const SlurmFiles& files, const SlurmFlags& flags,
                          bool json);

/// Tells the file that a shard has made.
void print_shard(const std::string& file, bool json);

}  // namespace penumbra::tools
