#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <CLI/CLI.hpp>

#include <filesystem>

#include "capture/frames.h"
#include "capture/recording/folder.h"
#include "capture/studio/studio.h"
#include "codec/codec.h"
#include "codec/display.h"
#include "compositor/compositor.h"
#include "core/files.h"
#include "core/stop_signal.h"
#include "runtime/pipeline/pipeline.h"
#include "runtime/pipeline/report.h"
#include "runtime/studio/studio_setup.h"
#include "tools/common/command.h"
#include "tools/common/light_options.h"
#include "tools/common/output.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/common/summary.h"
#include "tools/penumbra/commands.h"

namespace penumbra::tools {

namespace {

struct DemoOptions {
  bool headless = false, live = false, json = false, animated = true, video = true, fine = false;
  int frames = 90;
  std::string output = "out/demo";
  std::optional<std::string> environment, asset, animation, real_mesh, record;
  int width = 1280, height = 720;
  double fps = 30;
  int bands = 5;
  std::string lights = "auto";
  double budget = kDefaultMaxShadowError;
};

using compositor::Compositor;

// Passes frames on and records them as they come.
class RecordingSource : public capture::FrameSource {
 public:
  RecordingSource(capture::FrameSource& source, capture::CaptureFolderWriter writer)
      : source_(source), writer_(std::move(writer)) {}
  const std::vector<capture::CameraInfo>& cameras() const override { return source_.cameras(); }
  Result<std::optional<capture::Frame>> next() override {
    auto frame = source_.next();
    if (frame && *frame) PENUMBRA_TRY(writer_.write(**frame));
    return frame;
  }
  double view_rate() const override { return source_.view_rate(); }
  Result<void> finish() { return writer_.finish(); }

 private:
  capture::FrameSource& source_;
  capture::CaptureFolderWriter writer_;
};

Result<void> check(const DemoOptions& o) {
  if (o.frames < 1) return fail(ErrorCode::kInvalid, "--frames", "must be positive");
  for (const auto& [name, side] : {std::pair{"--width", o.width}, {"--height", o.height}})
    if (side < 64 || side > 8192)
      return fail(ErrorCode::kInvalid, name, fmt::format("{} is not within 64..8192", side));
  if (!(o.fps > 0 && o.fps <= 1000))
    return fail(ErrorCode::kInvalid, "--fps", "not within 0..1000");
  if (o.bands < 1 || o.bands > kMaxBands)
    return fail(ErrorCode::kInvalid, "--bands", "not within 1..9");
  PENUMBRA_TRY(choose_max_lights(o.lights));
  PENUMBRA_TRY(check_budget(o.budget));
  if (o.live && o.record)
    return fail(ErrorCode::kInvalid, "--record", "records a replayed demo, not a live one");
  return {};
}

// False when the user has closed the window.
bool show(Compositor& output, const FramePixels& pixels) {
  return !output.has_window() || output.present(codec::to_display(pixels));
}

// The recording's folder, where one is asked for: refused before the long work when it holds a capture.
Result<std::optional<OutputFolder>> open_record(const DemoOptions& o) {
  std::optional<OutputFolder> out;
  if (!o.record) return out;
  if (capture::holds_capture(*o.record))
    return fail(ErrorCode::kUnwritable, *o.record, "already holds a capture");
  auto folder = OutputFolder::create(*o.record);
  if (!folder) return std::unexpected(folder.error());
  out.emplace(std::move(*folder));
  return out;
}

Result<runtime::StudioSetup> set_up(const DemoOptions& o) {
  runtime::StudioRequest request;
  request.environment = o.environment;
  request.asset = o.asset;
  request.animation = o.animation;
  request.real_mesh = o.real_mesh;
  request.animated = o.animated;
  request.width = o.width;
  request.height = o.height;
  request.fps = o.fps;
  request.frames = o.frames;
  // A live camera costs the machine nothing; its frames are filmed before the clock starts.
  request.clip = o.live ? 16 : 0;
  return runtime::set_up_studio(request, progress_bar);
}

PipelineOptions pipeline_options(const DemoOptions& o) {
  PipelineOptions options;
  options.bands = o.bands;
  options.max_lights = choose_max_lights(o.lights)->max_count;  // checked before
  options.max_shadow_error = o.budget;
  options.measure_costs = o.live;
  options.window = !o.headless;
  options.progress = progress_bar;
  // A first picture in seconds; what moves at camera rate wants all that a bake can give.
  if (!o.fine && !o.live) {
    options.bake.rays = options.bake.ground_rays = 256;
    options.bake.visibility = false;
  }
  return options;
}

}  // namespace

Result<void> demo(const DemoOptions& o) {
  PENUMBRA_TRY(check(o));
  auto output = OutputFolder::create(o.output);
  if (!output) return std::unexpected(output.error());
  auto record = open_record(o);
  if (!record) return std::unexpected(record.error());
  PENUMBRA_ASSIGN(setup, set_up(o));
  capture::Studio studio(setup.world, setup.options);
  PENUMBRA_ASSIGN(pipeline, Pipeline::create(studio.cameras(), setup.scene, pipeline_options(o)));
  for (const Exposure& e : studio.schedule())
    spdlog::info("environment camera: exposure {:.3g} ms at gain {}", 1e3 * e.time.count(),
                 e.gain.value());
  const std::atomic<bool>& stop = catch_stop_signals();
  PENUMBRA_TRY(output->begin());
  auto writer =
      FrameWriter::create({output->work(), false, o.video, o.fps, o.live}, pipeline.timings());
  if (!writer) return std::unexpected(writer.error());
  std::optional<RecordingSource> recording;
  if (o.record) {
    PENUMBRA_TRY((*record)->begin());
    auto recorder = capture::CaptureFolderWriter::create((*record)->work(), studio.cameras());
    if (!recorder) return std::unexpected(recorder.error());
    recording.emplace(studio, std::move(*recorder));
  }
  std::shared_ptr<const FramePixels> last, last_source;
  const runtime::Sink sink = [&](const runtime::Output& out) {
    last = out.pixels;
    last_source = out.source.pixels;
    if (stop || !show(pipeline.output(), *out.pixels)) return false;
    return (*writer)->write("", out.pixels, true);
  };
  capture::FrameSource& source =
      recording ? static_cast<capture::FrameSource&>(*recording) : studio;
  auto counts = o.live ? pipeline.run_live(source, sink, stop) : pipeline.replay(source, sink);
  if (!counts) return std::unexpected(counts.error());
  if (stop) return stopped(o.output);
  PENUMBRA_TRY((*writer)->finish());
  if (recording) {
    PENUMBRA_TRY(recording->finish());
    PENUMBRA_TRY(runtime::write_scene((*record)->file("scene.toml"), setup.scene));
    PENUMBRA_TRY((*record)->keep());
  }
  PENUMBRA_TRY(codec::write_frame(output->file("still.png"), codec::to_display(*last)));
  PENUMBRA_TRY(codec::write_frame(output->file("camera.png"), codec::to_display(*last_source)));
  const nlohmann::json summary =
      summarise(*counts, pipeline.timings(),
                {o.bands, o.width, o.height, static_cast<int>(pipeline.scene().objects.size()),
                 pipeline.output().renderer()});
  PENUMBRA_TRY(write_bytes(output->file("summary.json"), summary.dump(2) + "\n"));
  PENUMBRA_TRY(output->keep());
  if (o.json) {
    print_json(summary);
  } else {
    print_summary(summary);
    if (o.video) fmt::print("{}/video.mp4  ", o.output);
    fmt::print("{0}/still.png  {0}/camera.png (before)  {0}/summary.json\n", o.output);
  }
  return {};
}

void add_demo(CLI::App& parent, Action& action) {
  static DemoOptions demo_options;
  auto* c =
      parent.add_subcommand("demo", "The main job on a synthetic studio: video, still, summary");
  c->add_flag("--headless", demo_options.headless, "No window even with a display");
  c->add_option("--frames", demo_options.frames, "View frames")->capture_default_str();
  c->add_option("--out", demo_options.output, "Output folder")->capture_default_str();
  c->add_option("--environment", demo_options.environment,
                "HDR environment; the built-in room by default");
  c->add_option("--asset", demo_options.asset,
                "Object; the built-in knot by default, or with --animation builtin:walker");
  c->add_option("--animation", demo_options.animation,
                "Clip that the asset plays, by name or number; its frames are baked first")
      ->check(not_empty);
  c->add_option("--real-mesh", demo_options.real_mesh,
                "Mesh of something that really stands in the studio, or builtin:box");
  c->add_flag("!--no-turntable", demo_options.animated, "Leave out the turning object");
  c->add_option("--record", demo_options.record,
                "Also record a capture folder with its scene.toml");
  c->add_flag("!--no-video", demo_options.video, "Still and summary alone");
  c->add_flag("--live", demo_options.live,
              "Cameras (filmed beforehand), light and composite on threads, paced by the clock; "
              "distant lights are given up where --fps leaves no time");
  c->add_option("--width", demo_options.width, "Of the view frames, in pixels")
      ->capture_default_str();
  c->add_option("--height", demo_options.height, "Of the view frames, in pixels")
      ->capture_default_str();
  c->add_option("--fps", demo_options.fps, "View camera, frames a second")->capture_default_str();
  c->add_option("--bands", demo_options.bands, "1 to 9")->capture_default_str();
  c->add_option("--max-lights", demo_options.lights, kMaxLightsHelp)->capture_default_str();
  c->add_option("--max-shadow-error", demo_options.budget, kMaxShadowErrorHelp)
      ->capture_default_str();
  c->add_flag(
      "--fine", demo_options.fine,
      "Bake as finely as the other commands do: 1024 rays a vertex instead of 256, and maps of "
      "what each vertex sees; --live always does");
  add_json(c, demo_options.json);
  c->callback([&] { action = [] { return demo(demo_options); }; });
}

}  // namespace penumbra::tools
