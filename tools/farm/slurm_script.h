// The text that submits a bake to Slurm: arrays of shards, and jobs that depend on them.
// threads: reentrant
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/result.h"

namespace penumbra::tools {

/// A job, or an array of them; it waits until those of the stage before have ended, well or not:
/// what it needs of them it checks itself, and says what is missing.
struct SlurmStage {
  std::string name;                    // of its logs: "shards", "round-1", "merge"
  std::vector<std::string> arguments;  // of the program
  int tasks = 0;                       // of the array; 0: a single job
  double seconds = 0;                  // asked for, of each
  std::uint64_t bytes = 0;             // of memory, of each
};

/// Slurm counts minutes, and kills a job by them: less than that is no bound worth asking for.
inline constexpr double kMinSeconds = 300;

struct SlurmPlan {
  std::string title;    // of the jobs, such as the output's name
  std::string mark;     // the comment of the jobs, which tells outputs of one name apart
  std::string program;  // path, the same on all machines
  std::string folder;   // that jobs run in, shared
  std::string logs;     // folder of what jobs say, shared
  std::string copied;   // an argument that is a file to be copied to the machines; empty: none
  int cores = 1;        // of each task
  std::vector<SlurmStage> stages;
};

/// A program of bash that submits all stages, takes back what it submitted where one is refused,
/// and prints the jobs' numbers in one line, in the stages' order.
/// errors: kInvalid (a control character in a path or argument, no stage)
Result<std::string> slurm_script(const SlurmPlan& plan);

/// A word as bash reads it back, whatever is in it.
std::string shell_quoted(const std::string& word);

}  // namespace penumbra::tools
