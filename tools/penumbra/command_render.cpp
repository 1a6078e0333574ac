#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <filesystem>

#include "capture/recording/folder.h"
#include "codec/codec.h"
#include "core/environment.h"
#include "core/io/files.h"
#include "lighting/estimate.h"
#include "lighting/light_estimate.h"
#include "runtime/pipeline/light_file.h"
#include "runtime/pipeline/report.h"
#include "runtime/scene/scene.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/penumbra/commands.h"
#include "tools/pictures/still.h"
#include "tools/runs/light_options.h"

namespace penumbra::tools {

namespace {

struct RenderOptions {
  std::string scene, environment, camera, output;
  runtime::EnvironmentOrientation orientation;
  std::string bands = "auto", lights = "auto";
  bool reference = false, without_objects = false;
  double error = .01, time_s = 0;
  std::optional<int> truncated_to;  // reference under light cut to so many bands
  bool json = false;
};

// The scene's view and lens.
Result<void> read_view(const std::string& path, StillScene& out) {
  PENUMBRA_ASSIGN(camera, capture::read_camera_file(path));
  const calib::CameraModel& p = camera.projection;
  if (!calib::has_intrinsics(p.kind))
    return fail(ErrorCode::kInvalid, path,
                "is a map of the whole sphere, and pictures are made through a lens only");
  out.view = {p.width, p.height, p.focal_px, p.principal_px, camera.world_from_camera};
  if (p.kind != calib::ProjectionKind::kPinhole || p.is_distorted()) out.lens = p;
  return {};
}

}  // namespace

Result<void> render(const RenderOptions& o) {
  PENUMBRA_ASSIGN(lights, choose_max_lights(o.lights));
  if (!(o.error > 0 && o.error < 1))
    return fail(ErrorCode::kInvalid, "--error", "is not above 0 and below 1");
  const std::string extension = std::filesystem::path(o.output).extension().string();
  if (extension != ".exr" && extension != ".hdr")
    return fail(ErrorCode::kInvalid, o.output,
                "ends neither in .exr nor in .hdr, which hold linear radiance");
  if (!(std::abs(o.time_s) < 1e6))
    return fail(ErrorCode::kInvalid, "--time", "is not within -1e6..1e6 s");
  PENUMBRA_TRY(check_writable(o.output));
  PENUMBRA_ASSIGN(light, runtime::read_light(o.environment, o.orientation));
  PENUMBRA_ASSIGN(map, runtime::whole_latlong(light));
  StillScene in{.environment = &map, .seconds = o.time_s};
  PENUMBRA_TRY(read_view(o.camera, in));
  PENUMBRA_ASSIGN(bands, choose_bands(o.bands, light.light));
  if (o.truncated_to && (*o.truncated_to < 1 || *o.truncated_to > kMaxBands))
    return fail(ErrorCode::kInvalid, "--light-bands", "is not within 1..9");
  PENUMBRA_ASSIGN(scene, runtime::read_scene(o.scene));
  runtime::BakeSettings settings;
  settings.bands = bands;
  if (o.reference || o.without_objects)
    settings.rays = settings.ground_rays = 64, settings.bounces = 0, settings.visibility = false;
  PENUMBRA_ASSIGN(prepared, runtime::prepare(scene, settings, progress_bar));

  in.scene = &prepared;
  std::size_t used_lights = 0;
  const auto draw = [&]() -> Result<Still> {
    if (o.reference) {
      std::optional<lighting::LightEstimate> truncated;
      if (o.truncated_to) truncated = lighting::make_estimate(light.light, *o.truncated_to);
      return render_reference(in, !o.without_objects, o.error, truncated,
                              progress_bar("reference"));
    }
    auto real = render_real(in, o.error, progress_bar("real world"));
    if (!real || o.without_objects) return real;
    const lighting::SurfaceRoughness mirrored = runtime::mirrored_roughness(prepared);
    lighting::LightEstimator estimator({bands, lights});
    estimator.mirror(mirrored);
    Environment around;
    around.radiance = mirrored.empty() ? map : with_floor_below(map, prepared.planes);
    PENUMBRA_ASSIGN(estimate, estimator.estimate(around));
    used_lights = estimate.lights.size();
    return render_composite(in, estimate, *real);
  };
  PENUMBRA_ASSIGN(still, draw());
  PENUMBRA_TRY(codec::write_hdr(o.output, still.radiance, codec::Depth::kFloat));
  if (o.json) {
    print_json({{"width", in.view.width},
                {"height", in.view.height},
                {"bands", bands},
                {"lights", used_lights},
                {"reference", o.reference},
                {"error", still.error},
                {"samples_per_pixel", still.samples}});
  } else if (still.samples > 0) {
    fmt::print("{}: {}x{}, {} samples a pixel, estimated relative error {:.2f} %\n", o.output,
               in.view.width, in.view.height, still.samples, 100 * still.error);
  } else {
    fmt::print("{}: {}x{}, {} bands and {} lights\n", o.output, in.view.width, in.view.height,
               bands, used_lights);
  }
  return {};
}

void add_render(CLI::App& parent, Action& action) {
  static RenderOptions render_options;
  auto* c = parent.add_subcommand(
      "render", "Render a still of a scene in an environment, in linear radiance");
  c->add_option("--scene", render_options.scene, "Scene to render, scene.toml")->required();
  c->add_option("--environment", render_options.environment,
                "HDR environment map: .exr, .hdr, .jph, .jp2, .pnr, or .jpg with a gain map")
      ->required();
  add_orientation(*c, render_options.orientation);
  c->add_option("--camera", render_options.camera,
                "Camera file of a pinhole without distortion, with its pose")
      ->required();
  c->add_option("-o,--output", render_options.output, "Picture to write, .exr or .hdr")->required();
  c->add_option("--bands", render_options.bands, kBandsOfMapHelp)->capture_default_str();
  c->add_option("--max-lights", render_options.lights, kMaxLightsHelp)->capture_default_str();
  CLI::Option* const reference =
      c->add_flag("--reference", render_options.reference,
                  "Path-trace the picture, with the objects as part of the real scene");
  c->add_option("--time", render_options.time_s,
                "Time of the animation in seconds: the pose of clips and turning objects")
      ->capture_default_str();
  c->add_option("--error", render_options.error,
                "Relative error at which path tracing stops, above 0 and below 1")
      ->capture_default_str();
  c->add_option(
       "--light-bands", render_options.truncated_to,
       "With --reference: light the scene by this many bands of spherical harmonics, 1 to 9, "
       "instead of the whole environment")
      ->needs(reference);
  c->add_flag("--without-objects", render_options.without_objects, "Render the real scene alone");
  add_json(c, render_options.json);
  c->callback([&] { action = [] { return render(render_options); }; });
}

}  // namespace penumbra::tools
