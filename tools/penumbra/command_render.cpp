#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <CLI/CLI.hpp>

#include <filesystem>

#include "calib/camera/drawable.h"
#include "capture/environment/environment_file.h"
#include "capture/recording/folder.h"
#include "codec/codec.h"
#include "core/files.h"
#include "lighting/estimate.h"
#include "lighting/light_estimate.h"
#include "prt/geometry/pinhole_view.h"
#include "runtime/pipeline/light_file.h"
#include "runtime/pipeline/report.h"
#include "runtime/scene/scene.h"
#include "tools/common/command.h"
#include "tools/common/light_options.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/common/still.h"
#include "tools/penumbra/commands.h"

namespace penumbra::tools {

namespace {

struct RenderOptions {
  std::string scene, environment, camera, output;
  std::optional<std::string> projection;
  std::string bands = "auto", lights = "auto";
  bool reference = false, without_objects = false;
  double error = .01, time_s = 0;
  std::optional<int> truncated_to;  // reference under light cut to so many bands
  bool json = false;
};

Result<prt::PinholeView> read_view(const std::string& path) {
  auto camera = capture::read_camera_file(path);
  if (!camera) return std::unexpected(camera.error());
  PENUMBRA_TRY(calib::check_drawable(camera->projection, path));
  return prt::PinholeView{camera->projection.width, camera->projection.height,
                          camera->projection.focal_px, camera->projection.principal_px,
                          camera->world_from_camera};
}

}  // namespace

Result<void> render(const RenderOptions& o) {
  auto lights = choose_max_lights(o.lights);
  if (!lights) return std::unexpected(lights.error());
  if (!(o.error > 0 && o.error < 1)) return fail(ErrorCode::kInvalid, "--error", "not within 0..1");
  const std::string extension = std::filesystem::path(o.output).extension().string();
  if (extension != ".exr" && extension != ".hdr")
    return fail(ErrorCode::kInvalid, o.output, "linear radiance goes to .exr or .hdr");
  if (!(std::abs(o.time_s) < 1e6)) return fail(ErrorCode::kInvalid, "--time", "not within +-1e6 s");
  PENUMBRA_TRY(check_writable(o.output));
  auto light = runtime::read_light(o.environment, o.projection);
  if (!light) return std::unexpected(light.error());
  auto map = capture::to_latlong(light->file);
  if (!map) return std::unexpected(map.error());
  auto view = read_view(o.camera);
  if (!view) return std::unexpected(view.error());
  auto bands = choose_bands(o.bands, light->light);
  if (!bands) return std::unexpected(bands.error());
  if (o.truncated_to && (*o.truncated_to < 1 || *o.truncated_to > kMaxBands))
    return fail(ErrorCode::kInvalid, "--light-bands", "not within 1..9");
  auto scene = runtime::read_scene(o.scene);
  if (!scene) return std::unexpected(scene.error());
  runtime::BakeSettings settings;
  settings.bands = *bands;
  if (o.reference || o.without_objects)
    settings.rays = settings.ground_rays = 64, settings.bounces = 0;
  auto prepared = runtime::prepare(*scene, settings, progress_bar);
  if (!prepared) return std::unexpected(prepared.error());

  const StillScene in{&*prepared, &*map, *view, o.time_s};
  std::size_t used_lights = 0;
  const auto still = [&]() -> Result<Still> {
    if (o.reference) {
      std::optional<lighting::LightEstimate> truncated;
      if (o.truncated_to) truncated = lighting::make_estimate(light->light, *o.truncated_to);
      return render_reference(in, !o.without_objects, o.error, truncated,
                              progress_bar("reference"));
    }
    auto real = render_real(in, o.error, progress_bar("real world"));
    if (!real || o.without_objects) return real;
    auto estimate = lighting::estimate_map(*map, {*bands, *lights});
    if (!estimate) return std::unexpected(estimate.error());
    used_lights = estimate->lights.size();
    return render_composite(in, *estimate, *real);
  }();
  if (!still) return std::unexpected(still.error());
  PENUMBRA_TRY(codec::write_hdr(o.output, still->radiance, codec::Depth::kFloat));
  if (o.json) {
    print_json({{"width", view->width},
                {"height", view->height},
                {"bands", *bands},
                {"lights", used_lights},
                {"reference", o.reference},
                {"error", still->error},
                {"samples_per_pixel", still->samples}});
  } else if (still->samples > 0) {
    fmt::print("{}: {}x{}, {} samples a pixel, estimated relative error {:.2f} %\n", o.output,
               view->width, view->height, still->samples, 100 * still->error);
  } else {
    fmt::print("{}: {}x{}, {} bands and {} lights\n", o.output, view->width, view->height, *bands,
               used_lights);
  }
  return {};
}

void add_render(CLI::App& parent, Action& action) {
  static RenderOptions render_options;
  auto* c =
      parent.add_subcommand("render", "A still in linear radiance of a scene in an environment");
  c->add_option("--scene", render_options.scene, "scene.toml")->required();
  c->add_option("--environment", render_options.environment, "HDR environment")->required();
  c->add_option("--projection", render_options.projection, "As in light estimate");
  c->add_option("--camera", render_options.camera, "camera.toml")->required();
  c->add_option("-o,--output", render_options.output, "Output .exr or .hdr")->required();
  c->add_option("--bands", render_options.bands, "1 to 9, or auto")->capture_default_str();
  c->add_option("--max-lights", render_options.lights, kMaxLightsHelp)->capture_default_str();
  c->add_flag("--reference", render_options.reference,
              "Path-trace the picture with the objects really there");
  c->add_option("--time", render_options.time_s, "Seconds: where clips and turntables are then")
      ->capture_default_str();
  c->add_option("--error", render_options.error, "Relative error at which the reference stops")
      ->capture_default_str();
  c->add_option("--light-bands", render_options.truncated_to,
                "Path-trace under the light cut to so many bands instead of the whole environment");
  c->add_flag("--without-objects", render_options.without_objects, "The real world alone");
  add_json(c, render_options.json);
  c->callback([&] { action = [] { return render(render_options); }; });
}

}  // namespace penumbra::tools
