#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include <filesystem>

#include "capture/frames.h"
#include "capture/recording/recording.h"
#include "compositor/compositor.h"
#include "runtime/pipeline/governance.h"
#include "runtime/pipeline/light_stage.h"
#include "runtime/pipeline/runner.h"
#include "runtime/scene/scene.h"
#include "runtime/shading/compose_stage.h"
#include "tools/common/light_options.h"
#include "tools/common/print.h"
#include "tools/common/command.h"
#include "tools/penumbra/commands.h"
#include "core/files.h"
#include "runtime/pipeline/light_file.h"
#include "tools/common/output.h"
#include "tools/common/progress.h"
#include "runtime/pipeline/report.h"
#include "core/stop_signal.h"
#include "tools/common/summary.h"

namespace penumbra::tools {

namespace {

struct CompositeOptions {
  std::string capture, scene, output;
  int bands = 5;
  std::string discs = "auto";
  double budget = kDefaultBudget;
  bool json = false, video = true;
};

// The first view camera's frames are frame_000000.png; a second eye carries its name.
std::string still_name(const capture::CameraInfo& camera, bool first, std::uint64_t number) {
  return first ? fmt::format("frame_{:06}.png", number)
               : fmt::format("frame_{}_{:06}.png", camera.eye.empty() ? camera.name : camera.eye,
                             number);
}

}  // namespace

Result<void> composite(const CompositeOptions& o) {
  if (o.bands < 1 || o.bands > kMaxBands)
    return fail(ErrorCode::kInvalid, "--bands", "not within 1..9");
  auto discs = choose_discs(o.discs);
  if (!discs) return std::unexpected(discs.error());
  PENUMBRA_TRY(check_budget(o.budget));
  auto source = capture::open_capture(o.capture);
  if (!source) return std::unexpected(source.error());
  auto scene = runtime::read_scene(o.scene);
  if (!scene) return std::unexpected(scene.error());
  StageTimes times;
  const auto& cameras = (*source)->cameras();
  auto light = runtime::LightStage::create(cameras, {o.bands, *discs}, times);
  if (!light) return fail(light.error().code, o.capture, light.error().detail);
  // The output is tried before the long work.
  const double rate = (*source)->view_rate();
  auto folder = OutputFolder::create(o.output);
  if (!folder) return std::unexpected(folder.error());
  runtime::BakeSettings settings;
  settings.bands = o.bands;
  auto prepared = runtime::prepare(*scene, settings, progress_bar);
  if (!prepared) return std::unexpected(prepared.error());
  auto governance = runtime::make_governance(*prepared, o.budget, false);
  if (!governance) return std::unexpected(governance.error());
  light->govern(*governance);
  auto compose =
      runtime::ComposeStage::create(cameras, *prepared, compositor::Compositor::Surface::kOffscreen, times);
  if (!compose) return std::unexpected(compose.error());
  const std::atomic<bool>& stop = catch_stop_signals();
  PENUMBRA_TRY(folder->begin());
  auto writer = FrameWriter::create({folder->work(), true, o.video, rate > 0 ? rate : 30}, times);
  if (!writer) return std::unexpected(writer.error());

  int first_view = -1;
  std::vector<std::uint64_t> written(cameras.size());
  auto counts = runtime::run_replay(
      **source, *light, **compose,
      [&](const runtime::Output& out) {
        if (first_view < 0) first_view = out.source.camera;
        const bool first = out.source.camera == first_view;
        const auto camera = static_cast<std::size_t>(out.source.camera);
        const std::string name = still_name(cameras[camera], first, written[camera]++);
        return (*writer)->write(name, out.pixels, first) && !stop;
      },
      times);
  if (!counts) return std::unexpected(counts.error());
  if (stop) return stopped(o.output);
  PENUMBRA_TRY((*writer)->finish());
  const auto view = std::ranges::find(cameras, capture::Role::kView, &capture::CameraInfo::role);
  const nlohmann::json summary =
      summarise(*counts, times,
                {o.bands, view->projection.width, view->projection.height,
                 static_cast<int>(prepared->objects.size()), (*compose)->output().renderer()});
  PENUMBRA_TRY(write_bytes(folder->file("summary.json"), summary.dump(2) + "\n"));
  PENUMBRA_TRY(folder->keep());
  if (o.json)
    print_json(summary);
  else
    print_summary(summary);
  return {};
}

void add_composite(CLI::App& parent, Action& action) {
  static CompositeOptions composite_options;
  auto* c = parent.add_subcommand("composite",
                         "Replay a recording through the whole pipeline; the same bytes each time");
  c->add_option("--capture", composite_options.capture, "Capture folder")->required();
  c->add_option("--scene", composite_options.scene, "scene.toml")->required();
  c->add_option("--out", composite_options.output, "Output folder")->required();
  c->add_option("--bands", composite_options.bands, "1 to 9")->capture_default_str();
  c->add_option("--discs", composite_options.discs, kDiscsHelp)->capture_default_str();
  c->add_option("--budget", composite_options.budget, kBudgetHelp)->capture_default_str();
  c->add_flag("!--no-video", composite_options.video, "Stills alone");
  add_json(c, composite_options.json);
  c->callback([&] { action = [] { return composite(composite_options); }; });
}

}  // namespace penumbra::tools
