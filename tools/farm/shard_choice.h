// Which shard of a bake this process is: told on the command line or by the queue that started it.
// threads: reentrant; shard_of_environment() reads the environment
#pragma once

#include <functional>
#include <string>

#include "core/result.h"

namespace penumbra::tools {

inline constexpr int kMaxShards = 4096;

/// Shard `index` of `count`; the first one is 0.
struct ShardChoice {
  int index = 0, count = 1;
};

/// The value of an environment variable, null where it is not set.
using VariableOf = std::function<const char*(const char* name)>;

/// "i/n" with i in 1..n; "auto": the task of a Slurm array without gaps; "auto/n": the same, whose
/// array has to have n tasks, or a pod of an indexed Kubernetes job.
/// errors: kInvalid (not one of these, more than kMaxShards, variables that contradict each other),
///         kNotFound (auto, and no queue tells)
Result<ShardChoice> read_shard(const std::string& text, const VariableOf& variable);
/// The same, by this process's environment.
Result<ShardChoice> shard_of_environment(const std::string& text);

/// Cores that the queue gave to this task; 0 where it does not tell.
int cores_of_task(const VariableOf& variable);
int cores_of_task();

}  // namespace penumbra::tools
