#include "tools/farm/shard_choice.h"

#include <fmt/format.h>

#include <charconv>
#include <cstdlib>
#include <optional>
#include <string_view>

namespace penumbra::tools {

namespace {

std::optional<int> whole_number(std::string_view text) {
  int out = 0;
  const char* const end = text.data() + text.size();
  const auto [at, error] = std::from_chars(text.data(), end, out);
  if (error != std::errc() || at != end || out < 0) return std::nullopt;
  return out;
}

// A variable that counts something.
Result<int> number_of(const VariableOf& variable, const char* name) {
  const char* const text = variable(name);
  if (text == nullptr)
    return fail(ErrorCode::kNotFound, name, "is not set, and --shard auto needs it");
  if (const auto number = whole_number(text)) return *number;
  return fail(ErrorCode::kInvalid, name,
              fmt::format("\"{:.40}\" is not a whole number of 0 or more", text));
}

// A task that is submitted once more by itself has an array of its own, in which its number tells
// nothing: gaps and other sizes are refused instead of baking the wrong frames.
Result<ShardChoice> task_of_array(const VariableOf& variable, int asked) {
  PENUMBRA_ASSIGN(id, number_of(variable, "SLURM_ARRAY_TASK_ID"));
  PENUMBRA_ASSIGN(first, number_of(variable, "SLURM_ARRAY_TASK_MIN"));
  PENUMBRA_ASSIGN(count, number_of(variable, "SLURM_ARRAY_TASK_COUNT"));
  if (id < first || id - first >= count)
    return fail(ErrorCode::kInvalid, "SLURM_ARRAY_TASK_ID",
                fmt::format("{} is not one of {} tasks from {} on: the array must have no gaps", id,
                            count, first));
  if (variable("SLURM_ARRAY_TASK_MAX") != nullptr) {
    PENUMBRA_ASSIGN(last, number_of(variable, "SLURM_ARRAY_TASK_MAX"));
    if (last - first + 1 != count)
      return fail(
          ErrorCode::kInvalid, "SLURM_ARRAY_TASK_COUNT",
          fmt::format("{} tasks within {}..{}: the array must have no gaps", count, first, last));
  }
  if (asked != 0 && asked != count)
    return fail(ErrorCode::kInvalid, "--shard",
                fmt::format("auto/{} runs in an array of {} tasks", asked, count));
  return ShardChoice{id - first, count};
}

Result<ShardChoice> shard_of_queue(const VariableOf& variable, int asked) {
  // Slurm within Kubernetes: the inner queue is the one that shares the work out.
  if (variable("SLURM_ARRAY_TASK_ID") != nullptr) return task_of_array(variable, asked);
  if (variable("JOB_COMPLETION_INDEX") == nullptr)
    return fail(ErrorCode::kNotFound, "--shard",
                "auto finds neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX in the "
                "environment");
  if (asked == 0)
    return fail(ErrorCode::kInvalid, "--shard",
                "auto finds JOB_COMPLETION_INDEX, which has no number of shards beside it: write "
                "auto/n");
  PENUMBRA_ASSIGN(index, number_of(variable, "JOB_COMPLETION_INDEX"));
  if (index >= asked)
    return fail(ErrorCode::kInvalid, "JOB_COMPLETION_INDEX",
                fmt::format("{} is not within 0..{}, of auto/{}", index, asked - 1, asked));
  return ShardChoice{index, asked};
}

}  // namespace

Result<ShardChoice> read_shard(const std::string& text, const VariableOf& variable) {
  const auto refused = [&] {
    return fail(ErrorCode::kInvalid, "--shard",
                fmt::format("\"{:.40}\" is not i/n with i in 1..n and n at most {}, nor auto or "
                            "auto/n",
                            text, kMaxShards));
  };
  const std::size_t sign = text.find('/');
  const std::string_view first = std::string_view(text).substr(0, sign);
  int count = 0;
  if (sign != std::string::npos) {
    const auto told = whole_number(std::string_view(text).substr(sign + 1));
    if (!told || *told < 1 || *told > kMaxShards) return refused();
    count = *told;
  }
  if (first == "auto") {
    PENUMBRA_ASSIGN(found, shard_of_queue(variable, count));
    if (found.count > kMaxShards)
      return fail(
          ErrorCode::kInvalid, "--shard",
          fmt::format("an array of {} tasks has more than {} shards", found.count, kMaxShards));
    return found;
  }
  const auto index = whole_number(first);
  if (!index || *index < 1 || *index > count) return refused();
  return ShardChoice{*index - 1, count};
}

Result<ShardChoice> shard_of_environment(const std::string& text) {
  return read_shard(text, [](const char* name) { return std::getenv(name); });
}

int cores_of_task(const VariableOf& variable) {
  const char* const text = variable("SLURM_CPUS_PER_TASK");
  return text == nullptr ? 0 : whole_number(text).value_or(0);
}

int cores_of_task() {
  return cores_of_task([](const char* name) { return std::getenv(name); });
}

}  // namespace penumbra::tools
