#include "tools/farm/slurm_job.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <sstream>
#include <thread>

#include "core/io/files.h"
#include "core/io/log.h"
#include "tools/common/child_program.h"

namespace penumbra::tools {

namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr auto kPatience = std::chrono::minutes(10);  // with a controller that does not answer
constexpr auto kWorthSaying = std::chrono::seconds(60);

std::string last_line(const std::string& text) {
  std::istringstream lines(text);
  std::string out;
  for (std::string line; std::getline(lines, line);)
    if (!line.empty()) out = line;
  return out;
}

// A file's state, without clocks: those of machines that share it differ.
struct FileState {
  bool is_there = false;
  fs::file_time_type time{};
  std::uintmax_t bytes = 0;
  friend bool operator==(const FileState&, const FileState&) = default;
};

FileState state_of(const fs::path& path) {
  std::error_code error;
  FileState out;
  out.bytes = fs::file_size(path, error);
  if (error) return {};
  out.time = fs::last_write_time(path, error);
  out.is_there = !error;
  return out;
}

bool is_there(const fs::path& path) {
  std::error_code ignored;
  return fs::exists(path, ignored);
}

// Those that an earlier submission left: logs tell of one alone.
void remove_logs(const SlurmPlan& plan) {
  std::error_code error;
  std::vector<fs::path> logs;
  for (fs::directory_iterator at(plan.logs, error), end; !error && at != end; at.increment(error))
    if (at->path().extension() == ".log") logs.push_back(at->path());
  for (const fs::path& log : logs) fs::remove(log, error);
  fs::remove(plan.logs, error);  // only when it is empty
}

Result<std::vector<std::string>> submit(const SlurmPlan& plan) {
  PENUMBRA_ASSIGN(script, slurm_script(plan));
  PENUMBRA_TRY(run_child({"sbatch", "--version"}));
  PENUMBRA_ASSIGN(answer, run_child({"bash", "-s"}, script));
  if (answer.status != 0)
    return fail(ErrorCode::kUnavailable, "sbatch", last_line(answer.complaint));
  std::istringstream numbers(last_line(answer.output));
  std::vector<std::string> jobs;
  for (std::string job; numbers >> job;) jobs.push_back(job);
  if (jobs.size() != plan.stages.size())
    return fail(ErrorCode::kUnavailable, "sbatch",
                fmt::format("gave {} numbers for {} jobs", jobs.size(), plan.stages.size()));
  return jobs;
}

// An interrupted wait leaves its jobs: a second submission would bake everything twice.
Result<void> check_queue(const SlurmPlan& plan) {
  if (plan.mark.empty()) return {};
  const auto answer = run_child({"squeue", "--me", "--noheader", "--format=%F %k"});
  if (!answer || answer->status != 0) return {};
  std::vector<std::string> jobs;
  std::istringstream lines(answer->output);
  for (std::string job, mark; lines >> job && std::getline(lines >> std::ws, mark);)
    if (mark == plan.mark && std::ranges::find(jobs, job) == jobs.end()) jobs.push_back(job);
  if (jobs.empty()) return {};
  return fail(ErrorCode::kUnavailable, plan.title,
              fmt::format("has jobs of an earlier submission in the queue: wait for their end, or "
                          "scancel {}",
                          fmt::join(jobs, " ")));
}

// What the jobs of a submission had too little of.
struct Shortage {
  bool time = false, memory = false;
};

void ask_for_more(const Shortage& shortage, SlurmPlan& plan) {
  for (SlurmStage& stage : plan.stages) {
    if (shortage.time) stage.seconds = 2 * std::max(stage.seconds, kMinSeconds);
    if (shortage.memory) stage.bytes = 2 * std::max(stage.bytes, std::uint64_t{1} << 20);
  }
  if (shortage.time) log_warning("{}: asks for twice the time", plan.title);
  if (shortage.memory) log_warning("{}: asks for twice the memory", plan.title);
}

class SlurmWatch {
 public:
  SlurmWatch(const SlurmPlan& plan, const SlurmFiles& files, const SlurmWait& wait)
      : plan_(plan), files_(files), wait_(wait), before_(state_of(files.output)) {}

  /// Until no job is left.
  Result<void> wait_for(const std::vector<std::string>& jobs) {
    answered_ = began_ = Clock::now();
    told_ = false;
    while (true) {
      PENUMBRA_ASSIGN(left, jobs_left(jobs));
      tell_progress();
      if (!left) return {};
      std::this_thread::sleep_for(wait_.interval);
    }
  }
  /// Where the last job ended well, waits for its output: shared folders may show it late.
  Result<void> settle(const std::vector<std::string>& jobs);
  bool is_done() const { return state_of(files_.output) != before_ && is_there(files_.output); }
  /// Why the output is not there; nothing where submitting again may help.
  Result<void> find_fault() const;
  std::string missing() const;
  Shortage shortage() const { return shortage_; }

 private:
  Result<bool> jobs_left(const std::vector<std::string>& jobs);
  void tell_progress();

  const SlurmPlan& plan_;
  const SlurmFiles& files_;
  const SlurmWait& wait_;
  FileState before_;
  Clock::time_point answered_, began_;
  bool told_ = false, silent_ = false;
  std::size_t stage_ = 0;
  Shortage shortage_;
};

Result<bool> SlurmWatch::jobs_left(const std::vector<std::string>& jobs) {
  PENUMBRA_ASSIGN(answer, run_child({"squeue", "--noheader", "--format=%T %r", "--jobs",
                                     fmt::format("{}", fmt::join(jobs, ","))}));
  if (answer.status != 0) {
    // It forgets jobs some minutes after their end.
    if (answer.complaint.find("Invalid job id") != std::string::npos) return false;
    if (!silent_) log_warning("squeue: {}", last_line(answer.complaint));
    silent_ = true;
    if (Clock::now() - answered_ > kPatience)
      return fail(ErrorCode::kUnavailable, "squeue",
                  fmt::format("does not answer; jobs {} may go on", fmt::join(jobs, " ")));
    return true;
  }
  answered_ = Clock::now();
  silent_ = false;
  // What waits long for something else than its turn is worth a line.
  const std::string& lines = answer.output;
  if (!told_ && Clock::now() - began_ > kWorthSaying && lines.starts_with("PENDING") &&
      lines.find("RUNNING") == std::string::npos) {
    log_info("Slurm has no place yet: {}", lines.substr(8, lines.find('\n') - 8));
    told_ = true;
  }
  return !lines.empty();
}

Result<void> SlurmWatch::settle(const std::vector<std::string>& jobs) {
  if (is_done()) return {};
  PENUMBRA_ASSIGN(answer, run_child({"squeue", "--noheader", "--states=all", "--format=%F %T",
                                     "--jobs", fmt::format("{}", fmt::join(jobs, ","))}));
  std::istringstream lines(answer.output);
  bool ended_well = false;
  for (std::string job, state; lines >> job >> state;) {
    if (state == "CANCELLED")
      return fail(ErrorCode::kUnavailable, plan_.title,
                  fmt::format("job {} was cancelled; shards that are done are kept", job));
    ended_well |= job == jobs.back() && state == "COMPLETED";
    shortage_.time |= state == "TIMEOUT";
    shortage_.memory |= state == "OUT_OF_MEMORY";
  }
  const auto until = Clock::now() + wait_.lateness;
  while (ended_well && !is_done() && Clock::now() < until)
    std::this_thread::sleep_for(wait_.interval);
  return {};
}

void SlurmWatch::tell_progress() {
  if (!wait_.progress || is_done()) return;  // the last stage takes the shards away
  const auto done_of = [&](std::size_t stage) {
    const auto& shards = files_.shards[stage];
    return static_cast<double>(std::ranges::count_if(shards, is_there)) /
           static_cast<double>(std::max<std::size_t>(1, shards.size()));
  };
  while (stage_ < files_.shards.size()) {
    const double done = done_of(stage_);
    wait_.progress(done);
    if (done < 1) return;
    ++stage_;
  }
}

std::string SlurmWatch::missing() const {
  for (const auto& shards : files_.shards) {
    const auto first = std::ranges::find_if_not(shards, is_there);
    const auto others = std::count_if(first, shards.end(), std::not_fn(is_there)) - 1;
    if (first != shards.end() && others > 0)
      return fmt::format("{} and {} others", first->string(), others);
    if (first != shards.end()) return first->string();
  }
  return files_.output.string();
}

Result<void> SlurmWatch::find_fault() const {
  const auto refused = [&](const std::string& name) -> Result<void> {
    const fs::path log = fs::path(plan_.logs) / (name + ".log");
    const auto text = read_text(log);
    const std::string why = text ? refusal_in(*text) : "";
    if (why.empty()) return {};
    return fail(ErrorCode::kInvalid, log.string(), why);
  };
  // Later stages only repeat that something is missing.
  for (std::size_t stage = 0; stage < files_.shards.size(); ++stage) {
    const auto& shards = files_.shards[stage];
    bool whole = true;
    for (std::size_t i = 0; i < shards.size(); ++i) {
      if (is_there(shards[i])) continue;
      whole = false;
      PENUMBRA_TRY(refused(fmt::format("{}-{}", plan_.stages[stage].name, i + 1)));
    }
    if (!whole) return {};
  }
  return refused(plan_.stages.back().name);
}

}  // namespace

std::string refusal_in(const std::string& log) {
  constexpr std::string_view kStart = "penumbra: ";
  const std::string line = last_line(log);
  return line.starts_with(kStart) ? line.substr(kStart.size()) : "";
}

Result<SlurmOutcome> run_on_slurm(const SlurmPlan& plan, const SlurmFiles& files,
                                  const SlurmWait& wait) {
  SlurmOutcome out;
  SlurmPlan asked = plan;
  const auto start = Clock::now();
  PENUMBRA_TRY(check_queue(plan));
  while (true) {
    SlurmWatch watch(plan, files, wait);
    remove_logs(plan);
    PENUMBRA_ASSIGN(jobs, submit(asked));
    out.jobs = jobs;
    ++out.submissions;
    log_info("{}: submitted as jobs {}; an interrupt ends the wait alone, scancel {} the jobs",
             plan.title, fmt::join(jobs, ", "), fmt::join(jobs, " "));
    PENUMBRA_TRY(watch.wait_for(jobs));
    PENUMBRA_TRY(watch.settle(jobs));
    if (watch.is_done()) break;
    PENUMBRA_TRY(watch.find_fault());
    if (out.submissions >= wait.max_submissions)
      return fail(ErrorCode::kUnavailable, plan.title,
                  fmt::format("was submitted {} times, and still lacks {}; logs are in {}",
                              out.submissions, watch.missing(), plan.logs));
    log_warning("{}: jobs ended without {}: submitted again", plan.title, watch.missing());
    ask_for_more(watch.shortage(), asked);
  }
  out.seconds = std::chrono::duration<double>(Clock::now() - start).count();
  remove_logs(plan);
  return out;
}

}  // namespace penumbra::tools
