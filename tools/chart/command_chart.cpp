#include <fmt/format.h>
#include <CLI/CLI.hpp>
#include <algorithm>

#include "core/conventions.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "lighting/governor.h"
#include "runtime/governor/governor_config.h"
#include "runtime/scene/scene.h"
#include "tools/chart/benches/chart_bench.h"
#include "tools/chart/benches/through_sensor.h"
#include "tools/chart/charts/chart_environments.h"
#include "tools/chart/charts/chart_options.h"
#include "tools/chart/charts/chart_plot.h"
#include "tools/chart/charts/chart_shards.h"
#include "tools/chart/charts/chart_slurm.h"
#include "tools/chart/charts/light_chart.h"
#include "tools/chart/commands.h"
#include "tools/chart/governor/governor_bench.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/farm/core_limit.h"
#include "tools/farm/shard_choice.h"
#include "tools/farm/shard_file.h"
#include "tools/runs/output.h"

namespace penumbra::tools {

namespace {

// Calibrated on the project's own meshes, proved on those that are given.
Result<void> chart_governor(const ChartOptions& o) {
  const std::vector<std::string> own = {"builtin:knot", "builtin:twist", "builtin:box"};
  PENUMBRA_ASSIGN(calibration, make_trial_scenes(own, kBakeRays));
  PENUMBRA_ASSIGN(others, make_trial_scenes(o.assets.empty() ? own : o.assets, kBakeRays));
  PENUMBRA_ASSIGN(costs, runtime::fit_costs(calibration[0].prepared));
  PENUMBRA_ASSIGN(proof, prove_governor(calibration, others, costs, o.max_shadow_error, o.governor,
                                        progress_bar("random scenes")));
  if (proof.needed_factor > lighting::Governor::kConformalFactor)
    log_warning("the calibration scenes need a factor of {:.2f}, more than the program's {:.2f}",
                proof.needed_factor, lighting::Governor::kConformalFactor);
  if (o.json) {
    print_json({{"needed_factor", proof.needed_factor},
                {"factor", proof.factor},
                {"calibration_scenes", proof.calibration},
                {"scenes", proof.scenes},
                {"promised", proof.promised},
                {"kept", proof.kept},
                {"coverage_low", proof.coverage_low},
                {"median_regret", proof.median_regret},
                {"worst_regret", proof.worst_regret},
                {"mean_shadow_error", proof.mean_shadow},
                {"worst_shadow_error", proof.worst_shadow},
                {"mean_object_error", proof.mean_object},
                {"worst_object_error", proof.worst_object},
                {"mean_bands", proof.mean_bands},
                {"mean_lights", proof.mean_lights},
                {"mean_map_step", proof.mean_map_step},
                {"max_shadow_error", o.max_shadow_error}});
    return {};
  }
  fmt::print(
      "cost model, one thread: a map of 512 rows {:.2f} ms, in blocks {:.2f}; relighting {:.2f}; a "
      "narrow light {:.1f} ms with a fine shadow, {:.1f} with a coarse one; a wide one {:.1f}\n",
      costs.read_ms, costs.read_blocks_ms, costs.relight_ms, costs.fine_light_ms,
      costs.coarse_light_ms, costs.wide_light_ms);
  fmt::print(
      "{} scenes need a factor of {:.2f}, taken {:.2f}; of {} others {} had a plan within {:.3f}, "
      "{} kept it (at least {:.1f} % with 95 % confidence)\n",
      proof.calibration, proof.needed_factor, proof.factor, proof.scenes, proof.promised,
      o.max_shadow_error, proof.kept, 100 * proof.coverage_low);
  fmt::print(
      "chosen on average: {:.1f} bands, {:.1f} lights, blocks of {:.1f} pixels; shadow {:.4f} "
      "(worst {:.4f}), objects {:.1f} % (worst {:.1f}); {:.1f} times the cost of the cheapest that "
      "would have kept it (median; worst {:.1f})\n",
      proof.mean_bands, proof.mean_lights, proof.mean_map_step, proof.mean_shadow,
      proof.worst_shadow, 100 * proof.mean_object, 100 * proof.worst_object, proof.median_regret,
      proof.worst_regret);
  return {};
}

}  // namespace

Result<void> chart(const ChartOptions& o) {
  if (o.governor < 0 || o.governor > 10'000)
    return fail(ErrorCode::kInvalid, "--governor", "is not within 1..10000 scenes");
  if (!(o.max_shadow_error > 0 && o.max_shadow_error <= 1))
    return fail(ErrorCode::kInvalid, "--max-shadow-error", "is not above 0 and at most 1");
  if (o.lights < 0 || o.lights > 64)
    return fail(ErrorCode::kInvalid, "--max-lights", "is not within 0..64");
  if (o.governor > 0) return chart_governor(o);
  if (o.error && !(*o.error > 0 && *o.error < 1))
    return fail(ErrorCode::kInvalid, "--error", "is not above 0 and below 1");
  if (o.through_sensor) return chart_through_sensor(o);
  for (int b : o.bands)
    if (b < 1 || b > kMaxBands)
      return fail(ErrorCode::kInvalid, "--bands", fmt::format("{} is not within 1..9", b));
  PENUMBRA_ASSIGN(environments, read_environments(o.environments, o.with_procedural));
  std::vector<std::string> assets = o.assets;
  if (assets.empty()) assets = {"builtin:knot", "builtin:twist"};
  for (const std::string& asset : assets)  // all of them before the long work
    PENUMBRA_TRY(runtime::load_asset(asset, {.7f, .7f, .7f}, 0));
  if (o.slurm.slurm) return chart_on_slurm(o, assets.size() * environments.size());
  const CoreLimit cores;
  if (!o.shard.empty()) {
    PENUMBRA_ASSIGN(shard, shard_of_environment(o.shard));
    PENUMBRA_TRY(make_folder(o.output));
    PENUMBRA_ASSIGN(file, chart_shard(o, assets, environments, shard));
    print_shard(file, o.json);
    return {};
  }
  PENUMBRA_ASSIGN(output, OutputFolder::create(o.output));
  PENUMBRA_ASSIGN(points, o.merge > 0 ? read_chart_shards(o, assets, environments, o.merge)
                                      : chart_lights(o, assets, environments));
  PENUMBRA_TRY(output.begin());
  PENUMBRA_TRY(write_bytes(output.file("accuracy.csv"), chart_csv(points)));
  if (!o.truncated)
    if (const auto plots = write_chart_plots(output.work(), points); !plots)
      log_warning("the plots are not written: {}: {}", plots.error().where, plots.error().detail);
  PENUMBRA_TRY(output.keep());
  if (o.merge > 0) remove_shards(shard_files(chart_shards_stem(o), o.merge));
  if (o.json) {
    print_json({{"rows", chart_json(points)}});
  } else {
    fmt::print("{}/accuracy.csv, {}/error-time.svg\n", o.output, o.output);
  }
  return {};
}

void add_chart(CLI::App& parent, Action& action) {
  static ChartOptions chart_options;
  auto* c = parent.add_subcommand(
      "chart",
      "Measure error against time for many settings and for other methods; writes CSV and SVG");
  c->add_option("--out", chart_options.output, "Folder for the results")->capture_default_str();
  c->add_option(
      "--environment", chart_options.environments,
      "HDR environment maps: .exr, .hdr, .jph, .jp2, .pnr, or .jpg with a gain map; by default the "
      "built-in ones");
  c->add_flag("--with-procedural", chart_options.with_procedural,
              "Add the built-in environments to those of --environment");
  c->add_option("--asset", chart_options.assets,
                "Meshes of the objects; by default builtin:knot and builtin:twist");
  c->add_option(
       "--bands", chart_options.bands,
       "Chart only these fixed numbers of bands of spherical harmonics, 1 to 9, separated by "
       "commas, with --max-lights; by default the whole sweep")
      ->delimiter(',');
  c->add_option("--max-lights", chart_options.lights,
                "Maximum number of distant lights beside --bands, 0 to 64")
      ->capture_default_str();
  CLI::Option* const governor = c->add_option(
      "--governor", chart_options.governor,
      "Calibrate the governor on 59 random scenes, and test its promise on this many others, "
      "1 to 10000");
  c->add_option("--max-shadow-error", chart_options.max_shadow_error,
                "Limit of the errors that the governor has to keep, above 0 and "
                "at most 1; with --governor")
      ->capture_default_str();
  c->add_option(
      "--error", chart_options.error,
      "Relative error at which path tracing of the reference stops, above 0 and below 1; by "
      "default 0.004, with --through-sensor 0.012");
  c->add_flag(
      "--truncated", chart_options.truncated,
      "Compare with the reference under the same truncated light, which leaves the errors of bake, "
      "shadows and composite");
  const char* const kSensor = "The whole chain through both cameras' sensors instead";
  CLI::Option* const sensor = c->add_flag(
      "--through-sensor", chart_options.through_sensor,
      "Film each world, and compare the composite with a world in which the object stands; writes "
      "through-sensor.csv and through-sensor.svg");
  sensor->excludes(governor)->group(kSensor);
  c->add_option("--bits", chart_options.bits,
                "Bits of both cameras: 8 with the response of sRGB, 12 linear")
      ->check([](const std::string& text) {
        return text == "8" || text == "12" ? "" : "is neither 8 nor 12";
      })
      ->capture_default_str()
      ->needs(sensor)
      ->group(kSensor);
  c->add_option("--shortest-exposure", chart_options.shortest_exposure_s,
                "Shortest exposure time that the environment camera can take, seconds, above 0 and "
                "at most 1/30")
      ->capture_default_str()
      ->needs(sensor)
      ->group(kSensor);
  c->add_option("--view-lens", chart_options.view_lens,
                "What the view camera looks through: pinhole, barrel (a webcam's wide angle) or "
                "fisheye")
      ->check([](const std::string& text) {
        return std::ranges::find(kSensorLensNames, text) != kSensorLensNames.end()
                   ? ""
                   : "is none of pinhole, barrel and fisheye";
      })
      ->capture_default_str()
      ->needs(sensor)
      ->group(kSensor);
  c->add_flag("--stills", chart_options.stills,
              "Write camera, composite and truth of each case side by side, .exr")
      ->needs(sensor)
      ->group(kSensor);
  CLI::Option* const direct_light =
      c->add_flag("--direct-light", chart_options.direct_light,
                  "Chart ways to trace one distant light at an object's vertices: error of the "
                  "irradiance against time; by default of builtin:knot and builtin:walker")
          ->excludes(governor)
          ->excludes(sensor)
          ->group("A light at vertices instead");
  CLI::Option* const materials =
      c->add_flag("--materials", chart_options.materials,
                  "Chart ways to draw gold, chrome, brushed steel and plastic: error of the object "
                  "against time of a light estimate and a frame; by default of builtin:knot and "
                  "builtin:ball in the built-in room")
          ->excludes(governor)
          ->excludes(sensor)
          ->excludes(direct_light)
          ->group("Materials instead");
  CLI::Option* const light_track =
      c->add_flag("--light-track", chart_options.light_track,
                  "Chart bytes against the error of the light for several coders of the maps of a "
                  "recording's light track")
          ->excludes(governor)
          ->excludes(sensor)
          ->excludes(direct_light)
          ->excludes(materials)
          ->group("Coding of a light track instead");
  CLI::Option* const still =
      c->add_option("--still", chart_options.stills_charted,
                    "HDR pictures: chart their bytes against their errors for several coders")
          ->excludes(governor)
          ->excludes(sensor)
          ->excludes(direct_light)
          ->excludes(light_track)
          ->excludes(materials)
          ->group("Coding of HDR pictures instead");
  const char* const kClip = "Compression of a clip's transfer instead";
  CLI::Option* const clip =
      c->add_option(
           "--animation", chart_options.animation,
           "Clip of the first --asset, by default of builtin:walker: chart bytes against the error "
           "of the rendered picture for several coders of its transfer")
          ->check(not_empty)
          ->excludes(governor)
          ->excludes(sensor)
          ->excludes(direct_light)
          ->excludes(light_track)
          ->excludes(still)
          ->excludes(materials)
          ->group(kClip);
  c->add_option("--light-map", chart_options.light_map,
                "Size of the light map, WIDTHxHEIGHT texels, 8 to 4096 each")
      ->capture_default_str()
      ->needs(clip)
      ->group(kClip);
  c->add_option("--frames", chart_options.frames,
                "Number of frames that are taken from the clip, 1 to 1000")
      ->capture_default_str()
      ->needs(clip)
      ->group(kClip);
  c->add_option("--samples", chart_options.samples,
                "Number of rays per texel and frame, a multiple of 64")
      ->capture_default_str()
      ->needs(clip)
      ->group(kClip);
  const char* const kShards = "In shards: of an asset's environments, or of a clip's frames";
  CLI::Option* const shard =
      c->add_option("--shard", chart_options.shard,
                    "i/n: chart only every n-th case from the i-th on, an asset in an environment, "
                    "or bake every n-th frame, into a file of the folder that --merge reads; auto: "
                    "the task of a Slurm array; auto/n: that, or the pod of an indexed Kubernetes "
                    "job")
          ->excludes(governor)
          ->excludes(sensor)
          ->group(kShards);
  CLI::Option* const merge =
      c->add_option("--merge", chart_options.merge, "Number of shards to join into the chart")
          ->check(within(1, kMaxShards))
          ->excludes(shard)
          ->excludes(governor)
          ->excludes(sensor)
          ->group(kShards);
  add_slurm_flags(*c, chart_options.slurm,
                  "one for each case, or each ten minutes of a clip's bake")
      ->excludes(shard)
      ->excludes(merge)
      ->excludes(governor)
      ->excludes(sensor);
  for (const char* const other :
       {"--environment", "--with-procedural", "--bands", "--max-lights", "--max-shadow-error",
        "--error", "--truncated", "--shard", "--merge", "--slurm"})
    direct_light->excludes(c->get_option(other));
  for (const char* const other : {"--bands", "--max-lights", "--max-shadow-error", "--truncated",
                                  "--shard", "--merge", "--slurm"})
    materials->excludes(c->get_option(other));
  add_json(c, chart_options.json);
  c->callback([&] {
    action = [] {
      if (chart_options.direct_light) return chart_direct_light(chart_options);
      if (chart_options.materials) return chart_materials(chart_options);
      if (chart_options.light_track) return chart_light_track(chart_options);
      if (!chart_options.stills_charted.empty()) return chart_stills(chart_options);
      return chart_options.animation.empty() ? chart(chart_options) : chart_clip(chart_options);
    };
  });
}

}  // namespace penumbra::tools
