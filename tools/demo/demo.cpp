#include "tools/demo/demo.h"

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <filesystem>

#include "capture/frames.h"
#include "capture/recording/folder.h"
#include "capture/studio/studio.h"
#include "codec/codec.h"
#include "codec/display.h"
#include "compositor/composite/compositor.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "core/threads/stop_signal.h"
#include "runtime/pipeline/pipeline.h"
#include "runtime/pipeline/report.h"
#include "runtime/studio/studio_setup.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/runs/light_options.h"
#include "tools/runs/object_mouse.h"
#include "tools/runs/output.h"
#include "tools/runs/summary.h"

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
  double max_shadow_error = kDefaultMaxShadowError, rotation_deg = 0;
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
  if (o.frames < 1) return fail(ErrorCode::kInvalid, "--frames", "is not positive");
  for (const auto& [name, side] : {std::pair{"--width", o.width}, {"--height", o.height}})
    if (side < 64 || side > 8192)
      return fail(ErrorCode::kInvalid, name, fmt::format("{} is not within 64..8192", side));
  if (!(o.fps > 0 && o.fps <= 1000))
    return fail(ErrorCode::kInvalid, "--fps", "is not above 0 and at most 1000");
  if (o.bands < 1 || o.bands > kMaxBands)
    return fail(ErrorCode::kInvalid, "--bands", fmt::format("{} is not within 1..9", o.bands));
  PENUMBRA_TRY(choose_max_lights(o.lights));
  PENUMBRA_TRY(check_max_shadow_error(o.max_shadow_error));
  if (o.rotation_deg != 0 && !o.environment)
    return fail(ErrorCode::kInvalid, "--rotate-environment",
                "turns a map: give --environment as well");
  if (o.live && o.record)
    return fail(ErrorCode::kInvalid, "--record",
                "excludes --live: only a replayed demo is recorded");
  return {};
}

// False when the user has closed the window.
bool show(Compositor& output, const FramePixels& pixels) {
  return !output.has_window() || output.present(codec::to_display(pixels));
}

// The recording's folder, where one is asked for: refused before the long work when it holds a
// capture.
Result<std::optional<OutputFolder>> open_record(const DemoOptions& o) {
  std::optional<OutputFolder> out;
  if (!o.record) return out;
  if (capture::holds_capture(*o.record))
    return fail(ErrorCode::kUnwritable, *o.record,
                "already holds a capture: remove it, or choose another folder");
  PENUMBRA_ASSIGN(folder, OutputFolder::create(*o.record));
  out.emplace(std::move(folder));
  return out;
}

Result<runtime::StudioSetup> set_up(const DemoOptions& o) {
  runtime::StudioRequest request;
  request.environment = o.environment;
  request.environment_rotation_deg = o.rotation_deg;
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
  options.max_shadow_error = o.max_shadow_error;
  options.measure_costs = o.live;
  options.window = !o.headless;
  options.progress = progress_bar;
  // A first picture in seconds; what moves at camera rate wants all rays that a bake can have.
  const auto coarse = runtime::BakeSettings::coarse();
  if (!o.fine && !o.live) options.bake = coarse;
  if (!o.fine) {
    options.bake.max_edge_fraction = coarse.max_edge_fraction;
    options.bake.max_vertices = coarse.max_vertices;
  }
  return options;
}

ObjectMouse make_mouse(Pipeline& pipeline) {
  if (pipeline.output().has_window())
    log_info(
        "window: the left mouse button drags an object, the right one and the wheel turn it; "
        "keys 1 to 9 take an object away and put it back; space holds what turns or plays; Escape "
        "ends");
  return {pipeline.scene(),
          [&pipeline](std::string_view object, const auto& place) {
            return pipeline.move_object(object, place);
          },
          [&pipeline](std::string_view object, bool visible) {
            return pipeline.show_object(object, visible);
          },
          [&pipeline](std::string_view object, const auto& playback) {
            return pipeline.play_object(object, playback);
          }};
}

void print_results(const DemoOptions& o, const nlohmann::json& summary) {
  if (o.json) {
    print_json(summary);
    return;
  }
  print_summary(summary);
  if (o.video) fmt::print("{}/video.mp4  ", o.output);
  fmt::print("{0}/still.png  {0}/camera.png (before)  {0}/summary.json\n", o.output);
}

}  // namespace

Result<void> demo(const DemoOptions& o) {
  PENUMBRA_TRY(check(o));
  PENUMBRA_ASSIGN(output, OutputFolder::create(o.output));
  PENUMBRA_ASSIGN(record, open_record(o));
  PENUMBRA_ASSIGN(setup, set_up(o));
  capture::Studio studio(setup.world, setup.options);
  PENUMBRA_ASSIGN(pipeline, Pipeline::create(studio.cameras(), setup.scene, pipeline_options(o)));
  for (const Exposure& e : studio.schedule())
    log_info("environment camera: exposure {:.3g} ms at gain {}", 1e3 * e.time.count(),
             e.gain.value());
  const std::atomic<bool>& stop = catch_stop_signals();
  PENUMBRA_TRY(output.begin());
  PENUMBRA_ASSIGN(writer, FrameWriter::create({output.work(), false, o.video, o.fps, o.live},
                                              pipeline.timings()));
  std::optional<RecordingSource> recording;
  if (o.record) {
    PENUMBRA_TRY(record->begin());
    PENUMBRA_ASSIGN(recorder,
                    capture::CaptureFolderWriter::create(record->work(), studio.cameras()));
    recording.emplace(studio, std::move(recorder));
  }
  std::shared_ptr<const FramePixels> last, last_source;
  ObjectMouse mouse = make_mouse(pipeline);
  const runtime::Sink sink = [&](const runtime::Output& out) {
    last = out.pixels;
    last_source = out.source.pixels;
    if (stop || !show(pipeline.output(), *out.pixels)) return false;
    const auto camera = static_cast<std::size_t>(out.source.camera);
    if (pipeline.output().has_window())
      mouse.update(pipeline.output().pointer(), studio.cameras()[camera].projection,
                   out.source.world_from_camera);
    return writer->write("", out.pixels, FrameWriter::InVideo{out.source.time});
  };
  capture::FrameSource& source =
      recording ? static_cast<capture::FrameSource&>(*recording) : studio;
  PENUMBRA_ASSIGN(counts,
                  o.live ? pipeline.run_live(source, sink, stop) : pipeline.replay(source, sink));
  if (stop) return stopped(o.output);
  PENUMBRA_TRY(writer->finish());
  if (recording) {
    PENUMBRA_TRY(recording->finish());
    PENUMBRA_TRY(runtime::write_scene(record->file("scene.toml"), setup.scene));
    PENUMBRA_TRY(record->keep());
  }
  PENUMBRA_TRY(codec::write_frame(output.file("still.png"), codec::to_display(*last)));
  PENUMBRA_TRY(codec::write_frame(output.file("camera.png"), codec::to_display(*last_source)));
  const nlohmann::json summary =
      summarise(counts, pipeline.timings(),
                {o.bands, o.width, o.height, static_cast<int>(pipeline.scene().objects.size()),
                 pipeline.output().renderer()});
  PENUMBRA_TRY(write_bytes(output.file("summary.json"), summary.dump(2) + "\n"));
  PENUMBRA_TRY(output.keep());
  print_results(o, summary);
  return {};
}

void add_demo(CLI::App& app, Action& action) {
  static DemoOptions demo_options;
  app.add_flag("--headless", demo_options.headless,
               "Open no window, even where there is a display");
  app.add_option("--frames", demo_options.frames, "Number of view frames, at least 1")
      ->capture_default_str();
  app.add_option("--out", demo_options.output, "Folder for the results")->capture_default_str();
  app.add_option(
      "--environment", demo_options.environment,
      "HDR environment map: .exr, .hdr, .jph, .jp2, .pnr, or .jpg with a gain map; by default the "
      "built-in room");
  app.add_option("--rotate-environment", demo_options.rotation_deg, kRotationHelp)
      ->capture_default_str();
  app.add_option(
      "--asset", demo_options.asset,
      "Mesh of the still object; by default builtin:knot, with --animation builtin:walker");
  app.add_option(
         "--animation", demo_options.animation,
         "Clip that the object plays, by name or number; it is baked before the first frame")
      ->check(not_empty);
  app.add_option(
      "--real-mesh", demo_options.real_mesh,
      "Mesh of a real thing in the studio, such as builtin:box: it hides objects and receives "
      "their shadows");
  app.add_flag("!--no-turntable", demo_options.animated, "Leave out the turning object");
  app.add_option(
      "--record", demo_options.record,
      "Also record the frames into this folder, a capture folder with its scene.toml; not with "
      "--live");
  app.add_flag("!--no-video", demo_options.video, "Write no video");
  app.add_flag(
      "--live", demo_options.live,
      "Run cameras, light and composite on threads, paced by the clock, on frames that are "
      "rendered beforehand; distant lights are given up where --fps leaves no time");
  app.add_option("--width", demo_options.width, "Width of the view frames in pixels, 64 to 8192")
      ->capture_default_str();
  app.add_option("--height", demo_options.height, "Height of the view frames in pixels, 64 to 8192")
      ->capture_default_str();
  app.add_option("--fps", demo_options.fps,
                 "Frame rate of the view camera in frames a second, above 0 and at most 1000")
      ->capture_default_str();
  app.add_option("--bands", demo_options.bands, kMaxBandsHelp)->capture_default_str();
  app.add_option("--max-lights", demo_options.lights, kMaxLightsHelp)->capture_default_str();
  app.add_option("--max-shadow-error", demo_options.max_shadow_error, kMaxShadowErrorHelp)
      ->capture_default_str();
  app.add_flag(
      "--fine", demo_options.fine,
      "Bake as the other commands do, at four times as many vertices, with visibility maps and "
      "1024 "
      "rays per texel of the floor instead of 256; --live bakes coarse vertices like that");
  add_json(&app, demo_options.json);
  action = [] { return demo(demo_options); };
}

}  // namespace penumbra::tools
