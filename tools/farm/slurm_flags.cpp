#include "tools/farm/slurm_flags.h"

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <cstdint>
#include <filesystem>

#include "core/io/hash.h"
#include "tools/common/arguments.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/farm/shard_choice.h"

namespace penumbra::tools {

CLI::Option* add_slurm_flags(CLI::App& command, SlurmFlags& flags, const std::string& by_default) {
  const char* const kGroup = "In shards on Slurm";
  CLI::Option* const slurm =
      command
          .add_flag("--slurm", flags.slurm,
                    "Submit the shards as a job array and their merge to Slurm, by sbatch, and "
                    "wait; the folder of the output is shared by all machines")
          ->group(kGroup);
  command
      .add_option("--shards", flags.shards, "Number of shards, 1 to 4096; by default " + by_default)
      ->check(within(1, kMaxShards))
      ->needs(slurm)
      ->group(kGroup);
  command.add_option("--cores", flags.cores, "Number of cores of each shard, 1 to 1024")
      ->capture_default_str()
      ->check(within(1, 1024))
      ->needs(slurm)
      ->group(kGroup);
  command
      .add_option("--memory", flags.memory_mb,
                  "Memory of each job in MB, 1 to 16777216; by default by the estimate")
      ->check(within(1, 1 << 24))
      ->needs(slurm)
      ->group(kGroup);
  command
      .add_option("--time", flags.minutes,
                  "Time of each job in minutes, 1 to 525600; by default by the estimate")
      ->check(within(1, 525'600))
      ->needs(slurm)
      ->group(kGroup);
  command
      .add_flag("--print", flags.print,
                "Print the script that would be submitted, and submit nothing")
      ->needs(slurm)
      ->group(kGroup);
  return slurm;
}

Result<SlurmPlan> begin_plan(const std::string& output, const SlurmFlags& flags) {
  SlurmPlan out;
  std::error_code error;
  out.program = std::filesystem::read_symlink("/proc/self/exe", error).string();
  if (!error) out.folder = std::filesystem::current_path(error).string();
  if (error) return fail(ErrorCode::kUnavailable, "--slurm", error.message());
  out.title = std::filesystem::path(output).filename().string();
  Fnv1a hash;
  hash.add(out.folder.data(), out.folder.size()).add(output.data(), output.size());
  out.mark = fmt::format("penumbra-{:016x}", hash.value());
  out.logs = output + ".slurm";
  out.cores = flags.cores;
  return out;
}

Result<void> print_or_run(SlurmPlan plan, const SlurmFiles& files, const SlurmFlags& flags,
                          bool json) {
  for (SlurmStage& stage : plan.stages) {
    if (flags.memory_mb > 0) stage.bytes = static_cast<std::uint64_t>(flags.memory_mb) << 20;
    if (flags.minutes > 0) stage.seconds = 60. * flags.minutes;
  }
  if (flags.print) {
    PENUMBRA_ASSIGN(script, slurm_script(plan));
    fmt::print("{}", script);
    return {};
  }
  SlurmWait wait;
  wait.progress = progress_bar(plan.title);
  PENUMBRA_ASSIGN(outcome, run_on_slurm(plan, files, wait));
  const std::size_t shards = files.shards[0].size();
  const auto bytes = std::filesystem::file_size(files.output);
  if (json) {
    print_json({{"shards", shards},
                {"jobs", outcome.jobs},
                {"submissions", outcome.submissions},
                {"seconds", outcome.seconds},
                {"bytes", bytes}});
  } else {
    fmt::print("{}: {} shards on Slurm in {:.1f} s, submitted {} {}, {:.2f} MB\n",
               files.output.string(), shards, outcome.seconds, outcome.submissions,
               outcome.submissions == 1 ? "time" : "times", static_cast<double>(bytes) * 1e-6);
  }
  return {};
}

void print_shard(const std::string& file, bool json) {
  if (json) {
    print_json({{"shard", file}});
  } else {
    fmt::print("{}\n", file);
  }
}

}  // namespace penumbra::tools
