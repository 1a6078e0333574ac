#include "tools/farm/slurm_script.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

namespace penumbra::tools {

namespace {

constexpr std::uint64_t kMegabyte = std::uint64_t{1} << 20;
// A program that a signal ended, as the kernel does where memory is short, is begun again so often.
constexpr int kAttempts = 3;

bool has_control_character(const std::string& text) {
  return std::ranges::any_of(text, [](char c) {
    const auto byte = static_cast<unsigned char>(c);
    return byte < 0x20 || byte == 0x7f;
  });
}

Result<void> check_words(const SlurmPlan& plan) {
  std::vector<std::string> words{plan.title,  plan.mark, plan.program,
                                 plan.folder, plan.logs, plan.copied};
  for (const SlurmStage& stage : plan.stages) {
    words.push_back(stage.name);
    words.insert(words.end(), stage.arguments.begin(), stage.arguments.end());
  }
  for (const std::string& word : words)
    if (has_control_character(word))
      return fail(ErrorCode::kInvalid, "--slurm",
                  fmt::format("{} has a control character, which a script cannot hold",
                              shell_quoted(word).substr(0, 60)));
  if (plan.stages.empty()) return fail(ErrorCode::kInvalid, "--slurm", "has nothing to submit");
  return {};
}

// Slurm replaces %a and the like in names of logs.
std::string log_name(const SlurmPlan& plan, const SlurmStage& stage) {
  std::string out;
  for (const char c : plan.logs + "/" + stage.name) out += c == '%' ? "%%" : std::string(1, c);
  return out + (stage.tasks > 0 ? "-%a.log" : ".log");
}

std::string variable_of(const SlurmStage& stage) {
  std::string out = stage.name;
  std::ranges::replace_if(
      out, [](char c) { return !(std::isalnum(static_cast<unsigned char>(c)) != 0); }, '_');
  return "job_" + out;
}

// What sbatch is asked for beside `common`.
std::string request(const SlurmPlan& plan, std::size_t which) {
  const SlurmStage& stage = plan.stages[which];
  std::string out =
      fmt::format("--job-name={} --time={:.0f} --mem={}M --output={}",
                  shell_quoted(plan.title + " " + stage.name),
                  std::ceil(std::max(kMinSeconds, stage.seconds) / 60),
                  std::max<std::uint64_t>(1, (stage.bytes + kMegabyte - 1) / kMegabyte),
                  shell_quoted(log_name(plan, stage)));
  if (!plan.mark.empty()) out += " --comment=" + shell_quoted(plan.mark);
  if (stage.tasks > 0) out += fmt::format(" --array=1-{}", stage.tasks);
  if (which > 0)
    out += fmt::format(" --dependency=\"afterany:${}\"", variable_of(plan.stages[which - 1]));
  return out;
}

std::string command_line(const SlurmPlan& plan, const SlurmStage& stage) {
  std::string out = shell_quoted(plan.program);
  for (const std::string& word : stage.arguments) {
    const bool copied = !plan.copied.empty() && word == plan.copied;
    const std::string name = std::filesystem::path(word).filename().string();
    out += ' ' + (copied ? "\"$copies\"/" + shell_quoted(name) : shell_quoted(word));
  }
  return out;
}

std::string job_text(const SlurmPlan& plan, const SlurmStage& stage) {
  std::string out = "#!/usr/bin/env bash\n";
  // Where the folder is not on a machine Slurm goes elsewhere, and shards would be lost there.
  out += fmt::format("cd {} || exit 1\n", shell_quoted(plan.folder));
  if (!plan.copied.empty()) {
    const std::string name = std::filesystem::path(plan.copied).filename().string();
    out += fmt::format(
        "copies=$(mktemp -d \"${{TMPDIR:-/tmp}}/penumbra-XXXXXX\") || exit 1\n"
        "trap 'rm -rf \"$copies\"' EXIT\n"
        "sbcast --force {} \"$copies\"/{} || exit 1\n",
        shell_quoted(plan.copied), shell_quoted(name));
  }
  std::string attempts;
  for (int i = 1; i <= kAttempts; ++i) attempts += fmt::format(" {}", i);
  out += fmt::format(
      "# Ended by a signal, the program goes on where it stopped.\n"
      "for attempt in{}; do\n"
      "  {} && exit 0\n"
      "  status=$?\n"
      "  ((status > 128)) || exit \"$status\"\n"
      "  echo \"attempt $attempt ended by signal $((status - 128))\" >&2\n"
      "done\n"
      "exit \"$status\"\n",
      attempts, command_line(plan, stage));
  return out;
}

}  // namespace

std::string shell_quoted(const std::string& word) {
  const auto plain = [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) != 0 ||
           std::string_view("%+,-./:=@_").find(c) != std::string_view::npos;
  };
  if (!word.empty() && std::ranges::all_of(word, plain)) return word;
  std::string out = "'";
  for (const char c : word) out += c == '\'' ? "'\\''" : std::string(1, c);
  return out + "'";
}

Result<std::string> slurm_script(const SlurmPlan& plan) {
  PENUMBRA_TRY(check_words(plan));
  std::string out = fmt::format(
      "#!/usr/bin/env bash\n"
      "# Submits {} to Slurm. Partition and account come from SBATCH_PARTITION and "
      "SBATCH_ACCOUNT.\n"
      "set -euo pipefail\n"
      "cd {}\n"
      "mkdir -p {}\n"
      "common=(--parsable --ntasks=1 --cpus-per-task={} --requeue --open-mode=append\n"
      "        --chdir=\"$PWD\")\n"
      "jobs=()\n"
      "trap '((${{#jobs[@]}} == 0)) || scancel \"${{jobs[@]}}\"' ERR\n",
      shell_quoted(plan.title), shell_quoted(plan.folder), shell_quoted(plan.logs), plan.cores);
  for (std::size_t i = 0; i < plan.stages.size(); ++i) {
    const std::string job = variable_of(plan.stages[i]);
    out += fmt::format(
        "\n{0}=$(sbatch \"${{common[@]}}\" {1} <<'END_OF_JOB'\n{2}END_OF_JOB\n)\n"
        "{0}=${{{0}%%;*}}\n"
        "jobs+=(\"${0}\")\n",
        job, request(plan, i), job_text(plan, plan.stages[i]));
  }
  return out + "\necho \"${jobs[@]}\"\n";
}

}  // namespace penumbra::tools
