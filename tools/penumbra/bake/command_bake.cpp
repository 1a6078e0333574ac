#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <cstddef>
#include <filesystem>

#include "core/io/files.h"
#include "core/io/log.h"
#include "prt/bake/bake.h"
#include "prt/bake/baked_file.h"
#include "prt/clip/sequence.h"
#include "prt/geometry/ground_grid.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"
#include "runtime/pipeline/report.h"
#include "runtime/scene/scene.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/farm/shard_choice.h"
#include "tools/farm/slurm_flags.h"
#include "tools/penumbra/bake/bake_options.h"
#include "tools/penumbra/commands.h"
#include "tools/penumbra/memory_report.h"

namespace penumbra::tools {

Rgb albedo_of(const BakeCommandOptions& o) {
  return {static_cast<float>(o.albedo[0]), static_cast<float>(o.albedo[1]),
          static_cast<float>(o.albedo[2])};
}

Result<void> bake(const BakeCommandOptions& o) {
  if (!o.shard.empty() || o.merge != 0 || !o.light_map.empty() || o.slurm.slurm)
    return fail(ErrorCode::kInvalid, "--animation",
                "is missing, and --shard, --merge, --slurm and --light-map need it");
  if (o.samples < 64 || o.samples % 64 != 0)
    return fail(ErrorCode::kInvalid, "--samples",
                fmt::format("{} is not a positive multiple of 64", o.samples));
  if (std::filesystem::path(o.output).extension() != ".glb")
    return fail(ErrorCode::kInvalid, o.output, "does not end in .glb, as a baked object does");
  if (o.bands < 1 || o.bands > kMaxBands)
    return fail(ErrorCode::kInvalid, "--bands", fmt::format("{} is not within 1..9", o.bands));
  if (o.bounces < 0 || o.bounces > prt::kMaxBounces)
    return fail(ErrorCode::kInvalid, "--bounces",
                fmt::format("{} is not within 0..{}", o.bounces, prt::kMaxBounces));
  PENUMBRA_TRY(check_writable(o.output));
  PENUMBRA_ASSIGN(asset, runtime::load_asset(o.asset, albedo_of(o), .04f,
                                             static_cast<std::size_t>(o.max_vertices)));
  if (asset.fine)
    log_warning(
        "{}: {} of {} vertices are baked, and the file shows those: a scene draws the asset "
        "in full",
        o.asset, asset.mesh.positions.size(), asset.fine->mesh.positions.size());
  prt::Mesh& mesh = asset.mesh;
  prt::BakeOptions options;
  options.bands = o.bands;
  options.bounces = o.bounces;
  options.rays = o.samples;
  options.ground_rays = o.samples;
  options.visibility = true;
  // The receiver is the plane that the asset stands on; what it reflects is the scene's to say.
  options.receiver = prt::Receiver{prt::fit_ground_grid(mesh, prt::bounds_of(mesh).low.y), {}};
  options.floor_apart = true;
  options.progress = progress_bar("bake " + std::filesystem::path(o.asset).filename().string());
  auto baked = prt::bake(std::move(mesh), options);
  if (!baked) return fail(baked.error().code, o.asset, baked.error().detail);
  baked->surface = asset.surface;
  PENUMBRA_TRY(prt::write_baked(o.output, *baked));
  const prt::BakeReport& r = baked->report;
  const auto bytes = std::filesystem::file_size(o.output);
  const nlohmann::json memory = report_memory(*baked);
  if (o.json) {
    print_json({{"vertices", baked->mesh.positions.size()},
                {"texels", baked->ground_deficit.points},
                {"coefficients", coefficient_count(baked->transfer.bands)},
                {"channels", baked->transfer.channels},
                {"rays", r.rays},
                {"seconds", r.seconds},
                {"rays_per_second", static_cast<double>(r.rays) / r.seconds},
                {"standard_error", r.standard_error},
                {"bytes", bytes},
                {"memory", memory}});
  } else {
    fmt::print(
        "{}: {} vertices and {} receiver texels, {} coefficients, {:.1f} M rays in {:.2f} s "
        "({:.2f} M/s), "
        "standard error {:.2f} % of t_0, file of {:.2f} MB, {:.2f} MB of memory while it is "
        "drawn\n",
        o.output, baked->mesh.positions.size(), baked->ground_deficit.points,
        coefficient_count(baked->transfer.bands), static_cast<double>(r.rays) * 1e-6, r.seconds,
        static_cast<double>(r.rays) * 1e-6 / r.seconds, 100 * r.standard_error,
        static_cast<double>(bytes) * 1e-6, memory["without_lights_mb"].get<double>());
  }
  return {};
}

void add_bake(CLI::App& parent, Action& action) {
  static BakeCommandOptions bake_options;
  auto* c = parent.add_subcommand(
      "bake",
      "Precompute the radiance transfer of an object or of a clip, and its shadow basis on the "
      "floor");
  c->add_option(
       "asset", bake_options.asset,
       "Mesh to bake: glTF, OBJ, PLY, STL, FBX or COLLADA, or builtin:knot, builtin:twist, "
       "builtin:ball, builtin:box or builtin:walker")
      ->required();
  c->add_option("-o,--output", bake_options.output, "File to write: .glb, for a clip .shlm")
      ->required();
  c->add_option("--bands", bake_options.bands, "Number of bands of spherical harmonics, 1 to 9")
      ->capture_default_str();
  c->add_option("--bounces", bake_options.bounces,
                "Number of bounces of light that are traced, 0 to 256; from 2 on further ones are "
                "extrapolated")
      ->capture_default_str();
  c->add_option(
       "--samples", bake_options.samples,
       "Number of rays per vertex and texel of the floor, a multiple of 64; a still object's "
       "vertices send as many as their edges need up to 4096")
      ->capture_default_str();
  c->add_option("--max-vertices", bake_options.max_vertices,
                "Number of vertices from which on a mesh is simplified")
      ->capture_default_str()
      ->check(within(1'000, 10'000'000));
  c->add_option("--albedo", bake_options.albedo,
                "Albedo R G B, each 0 to 1, where the asset has no material")
      ->expected(3)
      ->check(within(0, 1))
      ->capture_default_str();
  add_json(c, bake_options.json);
  const char* const kClip = "A clip of a character";
  CLI::Option* const clip = c->add_option("--animation", bake_options.animation,
                                          "Clip to bake, by name or number, instead of one pose")
                                ->check(not_empty)
                                ->group(kClip);
  c->add_option("--receiver-albedo", bake_options.receiver_albedo,
                "Albedo of the plane under the clip, 0 to 1; 0: it reflects no light")
      ->check(within(0, 1))
      ->capture_default_str()
      ->needs(clip)
      ->group(kClip);
  c->add_option("--fps", bake_options.fps,
                "Key frames that are baked for each second of the clip, above 0 and at most 1000")
      ->capture_default_str()
      ->needs(clip)
      ->group(kClip);
  c->add_option(
       "--light-map", bake_options.light_map,
       "Keep transfer in a light map of WIDTHxHEIGHT texels, 8 to 4096 each, instead of at "
       "vertices; it is laid out by the asset's texture coordinates or, where these "
       "overlap, by an atlas of its own")
      ->needs(clip)
      ->group(kClip);
  c->add_option(
       "--error", bake_options.error,
       "Relative error of the rendered picture that compression may add, above 0 and below 1")
      ->capture_default_str()
      ->needs(clip)
      ->group(kClip);
  c->add_option(
       "--interpolation-error", bake_options.interpolation_error,
       "Relative error of the rendered picture that interpolation between two key frames may add, "
       "0 to 1: where it is more, further key frames are baked; 0: none are")
      ->capture_default_str()
      ->needs(clip)
      ->group(kClip);
  c->add_option(
       "--ground-texels", bake_options.ground_texels,
       "Texels along each side of the shadow basis on the floor, 8 to 1024; 0: no shadow basis")
      ->capture_default_str()
      ->needs(clip)
      ->group(kClip);
  CLI::Option* const shard =
      c->add_option(
           "--shard", bake_options.shard,
           "i/n: bake only every n-th key frame from the i-th on, into a file beside the output "
           "that --merge reads; auto: the task of a Slurm array; auto/n: that, or the pod of an "
           "indexed Kubernetes job")
          ->needs(clip)
          ->check(not_empty)
          ->group(kClip);
  c->add_option("--round", bake_options.round,
                "Bake the shard's part of the key frames between that --interpolation-error asks "
                "for, round 1 when all shards are baked, 2 and 3 when the round before is; what no "
                "round bakes --merge does")
      ->check(within(1, prt::kRounds))
      ->needs(shard)
      ->group(kClip);
  c->add_option("--merge", bake_options.merge,
                "Number of shards to join into the output, after the key frames that "
                "--interpolation-error asks for are baked")
      ->check(within(1, kMaxShards))
      ->needs(clip)
      ->group(kClip);
  CLI::Option* const slurm =
      add_slurm_flags(*c, bake_options.slurm, "so many that each takes about ten minutes")
          ->needs(clip);
  c->add_flag("--copy", bake_options.copy,
              "Copy the asset to each machine's own disk by sbcast, instead of reading it over the "
              "shared folder")
      ->needs(slurm)
      ->group(slurm->get_group());
  c->callback([&] {
    action = [] {
      return bake_options.animation.empty() ? bake(bake_options) : bake_clip(bake_options);
    };
  });
}

}  // namespace penumbra::tools
