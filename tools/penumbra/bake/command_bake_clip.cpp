#include <fmt/format.h>
#include <oneapi/tbb/global_control.h>

#include <filesystem>
#include <optional>

#include "core/io/files.h"
#include "core/io/log.h"
#include "prt/clip/key_frames.h"
#include "prt/clip/sequence.h"
#include "prt/geometry/animation.h"
#include "runtime/pipeline/report.h"
#include "runtime/scene/animated.h"
#include "runtime/scene/bake_cache.h"
#include "tools/common/median_time.h"
#include "tools/common/number_pairs.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/farm/core_limit.h"
#include "tools/farm/shard_choice.h"
#include "tools/farm/shard_file.h"
#include "tools/penumbra/bake/bake_options.h"

namespace penumbra::tools {

namespace {

namespace fs = std::filesystem;

Result<prt::SequenceOptions> options_of(const BakeCommandOptions& o) {
  prt::SequenceOptions out;
  out.frames_per_second = o.fps;
  out.bands = o.bands;
  out.bounces = o.bounces;
  out.rays = out.ground_rays = o.samples;
  out.error = o.error;
  out.interpolation_error = o.interpolation_error;
  if (!o.light_map.empty()) {
    PENUMBRA_ASSIGN(size, read_map_size("--light-map", o.light_map));
    out.map_width = size[0];
    out.map_height = size[1];
  }
  if (o.ground_texels != 0) {
    if (o.ground_texels < 8 || o.ground_texels > 1024)
      return fail(ErrorCode::kInvalid, "--ground-texels",
                  fmt::format("{} is neither 0 nor within 8..1024", o.ground_texels));
    out.ground_size = o.ground_texels;
  }
  for (const double a : {o.receiver_albedo, o.albedo[0], o.albedo[1], o.albedo[2]})
    if (!(a >= 0 && a <= 1))
      return fail(ErrorCode::kInvalid, "--albedo, --receiver-albedo", "are not within 0..1");
  if (o.samples < 64 || o.samples % 64 != 0)
    return fail(ErrorCode::kInvalid, "--samples",
                fmt::format("{} is not a positive multiple of 64", o.samples));
  const auto a = static_cast<float>(o.receiver_albedo);
  out.ground_albedo = {a, a, a};
  return out;
}

// Of decoding and relighting the surface at a moment between two frames, on one core.
double relight_ms(const prt::BakedSequence& s, const runtime::StandingCharacter& of) {
  const tbb::global_control one_core(tbb::global_control::max_allowed_parallelism, 1);
  RadianceSh light(s.surface.bands());
  for (int n = 0; n < light.size(); ++n) light[n] = {1, 1, 1};
  const auto turns = prt::bone_turns(of.character, prt::rest_pose(of.character));
  std::vector<float> out(3 * s.surface.stride());
  return median_ms(9, [&] { s.surface.relight(.5, light, turns, out); });
}

// Key frames besides those of --fps.
std::size_t frames_between(const prt::BakedSequence& s) {
  return s.keys.at.size() - s.keys.parts / prt::KeyFrames::kMaxParts;
}

// What the result does not keep to.
void warn(const BakeCommandOptions& o, const prt::BakedSequence& s) {
  const prt::SequenceReport& r = s.report;
  const bool coarse = o.interpolation_error > 0
                          ? r.worst_interpolation > prt::allowed_interpolation_error(
                                                        o.interpolation_error, r.standard_error)
                          : r.interpolation_error > 2 * o.error;
  if (coarse)
    log_warning(
        "{}: the clip moves fast, or jumps: interpolation between key frames errs by {:.1f} % at "
        "worst and by {:.1f} % RMS; a higher --fps lowers it",
        o.output, 100 * r.worst_interpolation, 100 * r.interpolation_error);
  if (r.compression_error > 1.02 * o.error)
    log_warning(
        "{}: --error {:.2g} % is not reached: the error is {:.2f} % with as many 16-bit values as "
        "a file can hold; fewer texels or bands, or a shorter clip, lower it",
        o.output, 100 * o.error, 100 * r.compression_error);
  if (r.interpolation_error == 0 && s.surface.frames() < 4 && s.seconds > 0)
    log_warning(
        "{}: there are too few key frames to measure the error between them; a higher --fps bakes "
        "more",
        o.output);
}

void report(const BakeCommandOptions& o, const prt::BakedSequence& s, bool merge_baked,
            double relight_ms) {
  const prt::SequenceReport& r = s.report;
  const auto bytes = fs::file_size(o.output);
  const double raw = 4. * static_cast<double>(s.surface.points()) * s.surface.frames() *
                     s.surface.channels() * coefficient_count(s.surface.bands());
  if (o.json) {
    print_json({{"clip", s.clip},
                {"frames", s.surface.frames()},
                {"frames_between", frames_between(s)},
                {"merge_baked", merge_baked},
                {"points", s.surface.points()},
                {"vertices", s.surface.points()},
                {"texels", s.ground_deficit.points()},
                {"coefficients", coefficient_count(s.surface.bands())},
                {"channels", s.surface.channels()},
                {"components", s.surface.max_components()},
                {"rays", r.rays},
                {"seconds", r.seconds},
                {"rays_per_second", static_cast<double>(r.rays) / r.seconds},
                {"standard_error", r.standard_error},
                {"compression_error", r.compression_error},
                {"interpolation_error", r.interpolation_error},
                {"worst_interpolation_error", r.worst_interpolation},
                {"relight_ms", relight_ms},
                {"raw_bytes", raw},
                {"bytes", bytes}});
    return;
  }
  fmt::print(
      "{}: {} frames, {} of them between those of --fps, of {} points and {} receiver texels, {} "
      "coefficients, {:.1f} M rays in {:.1f} "
      "s "
      "({:.1f} M/s), standard error {:.2f} % of t_0\n"
      "rendered error {:.2f} % by compression, {:.2f} % between frames (at worst {:.2f} %); up to "
      "{} components; "
      "{:.2f} MB of {:.0f} MB; a frame decoded and relit in {:.2f} ms on one core\n",
      o.output, s.surface.frames(), frames_between(s), s.surface.points(),
      s.ground_deficit.points(), coefficient_count(s.surface.bands()),
      static_cast<double>(r.rays) * 1e-6, r.seconds, static_cast<double>(r.rays) * 1e-6 / r.seconds,
      100 * r.standard_error, 100 * r.compression_error, 100 * r.interpolation_error,
      100 * r.worst_interpolation, s.surface.max_components(), static_cast<double>(bytes) * 1e-6,
      raw * 1e-6, relight_ms);
}

// Journals of the rounds before one, as far as they are there.
std::vector<fs::path> journals_before(const BakeCommandOptions& o, int count, int round) {
  std::vector<fs::path> out = shard_files(o.output, count);
  for (int r = 1; r < round; ++r)
    for (const fs::path& file : shard_files(o.output, count, r)) {
      std::error_code ignored;
      if (fs::exists(file, ignored)) out.push_back(file);
    }
  return out;
}

// A round reads all of the one before: what is not there would be baked twice.
Result<void> check_round_before(const BakeCommandOptions& o, int count) {
  for (const fs::path& file : shard_files(o.output, count, o.round - 1)) {
    std::error_code ignored;
    if (!fs::exists(file, ignored))
      return fail(ErrorCode::kNotFound, file.string(),
                  fmt::format("is missing: bake {} first",
                              o.round == 1 ? std::string("this shard")
                                           : fmt::format("this shard of round {}", o.round - 1)));
  }
  return {};
}

Result<void> bake_one_shard(const BakeCommandOptions& o, const runtime::StandingCharacter& of,
                            const prt::SequenceOptions& options, ShardChoice choice) {
  const prt::Shard shard{choice.index, choice.count};
  std::vector<fs::path> before;
  if (o.round > 0) {
    PENUMBRA_TRY(check_round_before(o, choice.count));
    before = journals_before(o, choice.count, o.round);
  }
  const fs::path file = shard_file(o.output, choice.index, choice.count, o.round);
  PENUMBRA_TRY(make_shard(
      file,
      [&](const fs::path& path) -> Result<bool> {
        PENUMBRA_ASSIGN(missing,
                        prt::missing_frames(of.character, of.clip, options, shard, before, path));
        return missing == 0;
      },
      [&](const fs::path& path) {
        return before.empty()
                   ? prt::bake_frames(of.character, of.clip, options, shard, path)
                   : prt::bake_round(of.character, of.clip, options, shard, before, path);
      }));
  print_shard(file.string(), o.json);
  return {};
}

struct Journals {
  std::vector<fs::path> files;
  bool merge_baked = false;  // what no shard held
};

// The journals that hold all frames; what of them shards have not baked is baked here.
Result<Journals> all_journals(const BakeCommandOptions& o, const runtime::StandingCharacter& of,
                              const prt::SequenceOptions& options) {
  if (o.merge == 0) {
    // Kept until all is done: a bake that is stopped goes on where it was.
    const fs::path journal = o.output + ".journal";
    runtime::tell_work(fs::path(o.asset).filename().string(), of.character, of.clip, options);
    PENUMBRA_TRY(prt::bake_frames(of.character, of.clip, options, {}, journal));
    return Journals{{journal}};
  }
  PENUMBRA_TRY(prt::check_shards(of.character, of.clip, options, shard_files(o.output, o.merge)));
  Journals journals{journals_before(o, o.merge, prt::kRounds + 1)};
  const fs::path between = o.output + ".between";
  PENUMBRA_ASSIGN(more, prt::bake_between(of.character, of.clip, options, journals.files, between));
  journals.merge_baked = more;
  if (more) journals.files.push_back(between);
  return journals;
}

Result<void> check_sharing(const BakeCommandOptions& o) {
  if (o.merge < 0 || o.merge > kMaxShards)
    return fail(ErrorCode::kInvalid, "--merge",
                fmt::format("{} is not within 1..{}", o.merge, kMaxShards));
  if (o.merge > 0 && !o.shard.empty())
    return fail(ErrorCode::kInvalid, "--merge", "excludes --shard: bake the shards first");
  if (o.slurm.slurm && (o.merge > 0 || !o.shard.empty()))
    return fail(ErrorCode::kInvalid, "--slurm", "excludes --shard and --merge: it runs both");
  if (o.round < 0 || o.round > prt::kRounds)
    return fail(ErrorCode::kInvalid, "--round",
                fmt::format("{} is not within 1..{}", o.round, prt::kRounds));
  return {};
}

}  // namespace

Result<void> bake_clip(const BakeCommandOptions& o) {
  if (fs::path(o.output).extension() != ".shlm")
    return fail(ErrorCode::kInvalid, o.output, "does not end in .shlm, as a baked clip does");
  PENUMBRA_ASSIGN(options, options_of(o));
  PENUMBRA_TRY(check_sharing(o));
  ShardChoice choice;
  if (!o.shard.empty()) {
    PENUMBRA_ASSIGN(told, shard_of_environment(o.shard));
    choice = told;
  }
  PENUMBRA_TRY(check_writable(o.output));
  PENUMBRA_ASSIGN(character, runtime::standing_character(o.asset, albedo_of(o), o.animation,
                                                         options.map_width, options.map_height));
  if (o.slurm.slurm) return bake_on_slurm(o, character, options);
  const CoreLimit cores;
  options.progress = progress_bar("bake " + fs::path(o.asset).filename().string());
  if (!o.shard.empty()) return bake_one_shard(o, character, options, choice);
  PENUMBRA_ASSIGN(journals, all_journals(o, character, options));
  PENUMBRA_ASSIGN(
      sequence, prt::compress_frames(character.character, character.clip, options, journals.files));
  PENUMBRA_TRY(prt::write_sequence(o.output, character.character, character.clip, sequence));
  remove_shards(journals.files);
  warn(o, sequence);
  report(o, sequence, journals.merge_baked, relight_ms(sequence, character));
  return {};
}

}  // namespace penumbra::tools
