// A clip's bake on Slurm: what its jobs run.
#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "core/io/files.h"
#include "prt/clip/sequence.h"
#include "runtime/scene/animated.h"
#include "tools/farm/clip_stages.h"
#include "tools/farm/shard_file.h"
#include "tools/farm/slurm_flags.h"
#include "tools/penumbra/bake/bake_options.h"

namespace penumbra::tools {

namespace {

namespace fs = std::filesystem;

// What each job is told besides its part: every setting, so that all of them bake the same.
std::vector<std::string> arguments_of(const BakeCommandOptions& o) {
  std::vector<std::string> out{"bake", o.asset, "--animation", o.animation, "-o", o.output};
  const auto add = [&](const char* flag, const auto& value) {
    out.insert(out.end(), {flag, fmt::format("{}", value)});
  };
  add("--bands", o.bands);
  add("--bounces", o.bounces);
  add("--samples", o.samples);
  out.push_back("--albedo");
  for (const double a : o.albedo) out.push_back(fmt::format("{}", a));
  add("--receiver-albedo", o.receiver_albedo);
  add("--fps", o.fps);
  add("--error", o.error);
  add("--interpolation-error", o.interpolation_error);
  add("--ground-texels", o.ground_texels);
  if (!o.light_map.empty()) add("--light-map", o.light_map);
  return out;
}

bool is_file(const std::string& asset) {
  return !asset.starts_with("builtin:");
}

// Formats whose textures, buffers or materials lie in files of their own.
Result<void> check_copy(const BakeCommandOptions& o) {
  if (!o.copy) return {};
  const std::string kind = lower_extension(o.asset);
  if (is_file(o.asset) && kind != ".gltf" && kind != ".obj" && kind != ".dae") return {};
  return fail(ErrorCode::kInvalid, "--copy",
              is_file(o.asset) ? fmt::format("{} may have files beside it, which sbcast does not "
                                             "copy: use .glb, or the shared folder",
                                             o.asset)
                               : fmt::format("{} is no file", o.asset));
}

Result<SlurmPlan> plan_of(const BakeCommandOptions& o, const ClipEstimate& e, int shards) {
  PENUMBRA_ASSIGN(plan, begin_plan(o.output, o.slurm));
  if (o.copy) plan.copied = o.asset;
  const bool has_between = o.interpolation_error > 0;
  const int most = has_between ? e.frames * int{prt::KeyFrames::kMaxParts} : e.frames;
  const int rounds = has_between && shards > 1 ? prt::kRounds : 0;
  for (int round = 0; round <= rounds; ++round)
    plan.stages.push_back(clip_array(e, arguments_of(o), shards, round));
  const SlurmStage merge = clip_merge(e, arguments_of(o), shards, most);
  if (has_between && shards == 1) {  // one shard bakes all that there is to bake
    plan.stages[0].seconds = plan.stages[0].seconds * most / e.frames + merge.seconds;
    plan.stages[0].bytes = merge.bytes;
  }
  plan.stages.push_back(merge);
  return plan;
}

// What is there of another bake is refused now, not by each task in its turn.
Result<void> check_old_shards(const BakeCommandOptions& o, const runtime::StandingCharacter& of,
                              const prt::SequenceOptions& options, int shards) {
  for (int i = 0; i < shards; ++i) {
    const fs::path file = shard_file(o.output, i, shards);
    std::error_code ignored;
    if (fs::exists(file, ignored))
      PENUMBRA_TRY(prt::missing_frames(of.character, of.clip, options, {i, shards}, {}, file));
  }
  return {};
}

}  // namespace

Result<void> bake_on_slurm(const BakeCommandOptions& o, const runtime::StandingCharacter& of,
                           const prt::SequenceOptions& options) {
  PENUMBRA_TRY(check_copy(o));
  PENUMBRA_ASSIGN(e, estimate_clip(of.character, of.clip, options, o.slurm.cores));
  // Shards that are there already are used: an estimate is never the same twice.
  const int known = count_of_shards(o.output);
  const int shards = o.slurm.shards > 0 ? o.slurm.shards : known > 0 ? known : shards_for(e);
  PENUMBRA_ASSIGN(plan, plan_of(o, e, shards));
  PENUMBRA_TRY(check_old_shards(o, of, options, shards));
  SlurmFiles files{o.output, {}};
  for (std::size_t round = 0; round + 1 < plan.stages.size(); ++round)
    files.shards.push_back(shard_files(o.output, shards, static_cast<int>(round)));
  return print_or_run(plan, files, o.slurm, o.json);
}

}  // namespace penumbra::tools
