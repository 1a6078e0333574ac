#include "tools/chart/charts/chart_slurm.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include "tools/chart/charts/chart_shards.h"
#include "tools/farm/clip_stages.h"
#include "tools/farm/shard_choice.h"
#include "tools/farm/shard_file.h"
#include "tools/farm/slurm_flags.h"

namespace penumbra::tools {

namespace {

namespace fs = std::filesystem;

// One asset in one environment, on one core: what was measured with a margin of three.
constexpr double kCaseCore_s = 3 * 2400;
constexpr double kReferenceError = .004;  // to which that reference was traced
constexpr std::uint64_t kCaseBytes = std::uint64_t{2} << 30;
// Coders take most of that: minutes for each of some twenty.
constexpr double kCodersCore_s = 4 * 3600;
constexpr double kCopies = 8;  // of all maps, as floats

std::vector<std::string> arguments_of_chart(const ChartOptions& o) {
  std::vector<std::string> out{"chart", "--out", o.output};
  const auto add_all = [&](const char* flag, const std::vector<std::string>& values) {
    if (values.empty()) return;
    out.push_back(flag);
    out.insert(out.end(), values.begin(), values.end());
  };
  const auto add = [&](const char* flag, const auto& value) {
    out.insert(out.end(), {flag, fmt::format("{}", value)});
  };
  add_all("--environment", o.environments);
  add_all("--asset", o.assets);
  if (o.with_procedural) out.emplace_back("--with-procedural");
  if (!o.bands.empty()) {
    std::string bands;
    for (const int b : o.bands) bands += fmt::format("{}{}", bands.empty() ? "" : ",", b);
    add("--bands", bands);
  }
  add("--max-lights", o.lights);
  if (o.error) add("--error", *o.error);
  if (o.truncated) out.emplace_back("--truncated");
  if (o.animation.empty()) return out;
  add("--animation", o.animation);
  add("--light-map", o.light_map);
  add("--frames", o.frames);
  add("--samples", o.samples);
  return out;
}

Result<SlurmPlan> begin_chart_plan(const ChartOptions& o) {
  PENUMBRA_ASSIGN(plan, begin_plan((fs::path(o.output) / "chart").string(), o.slurm));
  return plan;
}

}  // namespace

Result<void> chart_on_slurm(const ChartOptions& o, std::size_t cases) {
  PENUMBRA_ASSIGN(plan, begin_chart_plan(o));
  const int shards = o.slurm.shards > 0
                         ? o.slurm.shards
                         : static_cast<int>(std::min<std::size_t>(cases, std::size_t{kMaxShards}));
  const double each = std::ceil(static_cast<double>(cases) / shards);
  // Rays of the reference grow with the square of what its error shrinks by.
  const double finer =
      std::max(1., std::pow(kReferenceError / o.error.value_or(kReferenceError), 2));
  SlurmStage measure{"shards", arguments_of_chart(o), shards,
                     each * finer * kCaseCore_s / o.slurm.cores, kCaseBytes};
  measure.arguments.insert(measure.arguments.end(), {"--shard", fmt::format("auto/{}", shards)});
  SlurmStage merge{"merge", arguments_of_chart(o), 0, 0, kCaseBytes};
  merge.arguments.insert(merge.arguments.end(), {"--merge", fmt::format("{}", shards)});
  plan.stages = {measure, merge};
  return print_or_run(
      plan, {fs::path(o.output) / "accuracy.csv", {shard_files(chart_shards_stem(o), shards)}},
      o.slurm, o.json);
}

Result<void> chart_clip_on_slurm(const ChartOptions& o, const ChartedClip& clip) {
  PENUMBRA_ASSIGN(plan, begin_chart_plan(o));
  PENUMBRA_ASSIGN(
      e, estimate_clip(clip.standing.character, clip.standing.clip, clip.options, o.slurm.cores));
  const int shards = o.slurm.shards > 0 ? o.slurm.shards : shards_for(e);
  SlurmStage merge = clip_merge(e, arguments_of_chart(o), shards, e.frames);
  merge.seconds += kCodersCore_s / o.slurm.cores;
  // Journals hold halves.
  merge.bytes += static_cast<std::uint64_t>(kCopies * 2) * static_cast<std::uint64_t>(e.frames) *
                 e.frame_bytes;
  plan.stages = {clip_array(e, arguments_of_chart(o), shards, 0), merge};
  return print_or_run(
      plan,
      {fs::path(o.output) / "rate-distortion.csv", {shard_files(clip_shards_stem(o), shards)}},
      o.slurm, o.json);
}

}  // namespace penumbra::tools
