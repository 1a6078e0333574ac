// Bakes on Slurm: submits what a plan says, waits for its end, and submits again what was lost.
// threads: thread-bound; waits for minutes to days
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "core/result.h"
#include "tools/farm/slurm_script.h"

namespace penumbra::tools {

/// What the jobs of a plan leave, by which their progress is seen.
struct SlurmFiles {
  std::filesystem::path output;                            // of the last stage
  std::vector<std::vector<std::filesystem::path>> shards;  // by stage but the last, by task
};

struct SlurmOutcome {
  std::vector<std::string> jobs;  // numbers, by stage, of the last submission
  int submissions = 0;
  double seconds = 0;  // from the first submission to the end
};

struct SlurmWait {
  std::function<void(double done)> progress;  // 0..1, anew for each stage; or none
  std::chrono::milliseconds interval{2000};   // between two looks at the queue
  std::chrono::seconds lateness{90};          // of an output that another machine has written
  int max_submissions = 3;  // shards that are lost to signals, time limits or machines
};

/// Submits and waits until the output is new. Jobs that a machine's end stops are requeued by Slurm
/// itself; shards that are missing when all jobs have ended are submitted again, unless somebody
/// cancelled a job, with twice the time or memory where that was short. Where the program refused
/// its work, its own line is the error. An interrupt ends the wait, not the jobs; while those are
/// in the queue nothing is submitted anew.
/// errors: kUnavailable (no Slurm, no answer for ten minutes, sbatch refused, jobs of an earlier
///         submission, shards lost too often, cancelled), kInvalid (of slurm_script; the program
///         refused)
Result<SlurmOutcome> run_on_slurm(const SlurmPlan& plan, const SlurmFiles& files,
                                  const SlurmWait& wait);

/// The error that a program of ours wrote last in a log, without "penumbra: "; empty: none.
std::string refusal_in(const std::string& log);

}  // namespace penumbra::tools
