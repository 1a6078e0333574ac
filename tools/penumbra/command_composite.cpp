#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <filesystem>

#include "capture/frames.h"
#include "capture/recording/undamaged_frames.h"
#include "core/io/files.h"
#include "core/threads/stop_signal.h"
#include "runtime/pipeline/eye_moments.h"
#include "runtime/pipeline/pipeline.h"
#include "runtime/pipeline/report.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/penumbra/commands.h"
#include "tools/runs/light_options.h"
#include "tools/runs/output.h"
#include "tools/runs/summary.h"

namespace penumbra::tools {

namespace {

struct CompositeOptions {
  std::string capture, scene, output, moves;
  int bands = 5;
  std::string lights = "auto", light = "auto";
  double from_s = 0, seconds = 0;  // of the capture; 0: to its end
  double max_shadow_error = kDefaultMaxShadowError;
  bool json = false, stills = true, video = true, coarse = false;
};

// Ends so long behind its first picture; 0: at its end.
class PartOfCapture final : public capture::FrameSource {
 public:
  PartOfCapture(capture::FrameSource& whole, Seconds length) : whole_(whole), length_(length) {}
  const std::vector<capture::CameraInfo>& cameras() const override { return whole_.cameras(); }
  double view_rate() const override { return whole_.view_rate(); }
  /// Ended without a single one.
  bool has_no_picture() const { return ended_ && pictures_ == 0; }
  Result<std::optional<capture::Frame>> next() override {
    PENUMBRA_ASSIGN(frame, whole_.next());
    ended_ = !frame;
    if (!frame) return frame;
    const auto camera = static_cast<std::size_t>(frame->camera);
    if (cameras()[camera].role != capture::Role::kView) return frame;
    if (!begin_) begin_ = frame->time;
    if (length_.count() > 0 && frame->time - *begin_ >= length_) return std::nullopt;
    ++pictures_;
    return frame;
  }

 private:
  capture::FrameSource& whole_;
  Seconds length_;
  std::optional<TimestampNs> begin_;
  int pictures_ = 0;
  bool ended_ = false;
};

// The first view camera's frames are frame_000000.png; a second eye carries its name. Eyes of one
// moment have one number.
std::string still_name(const capture::CameraInfo& camera, bool first, std::uint64_t number) {
  return first ? fmt::format("frame_{:06}.png", number)
               : fmt::format("frame_{}_{:06}.png", camera.eye.empty() ? camera.name : camera.eye,
                             number);
}

// Both eyes of a stereo pair, the left one first; else the first view camera alone.
std::vector<int> cameras_in_video(const std::vector<capture::CameraInfo>& cameras) {
  int first = -1, left = -1, right = -1;
  for (int i = 0; i < static_cast<int>(cameras.size()); ++i) {
    const capture::CameraInfo& c = cameras[static_cast<std::size_t>(i)];
    if (c.role != capture::Role::kView) continue;
    if (first < 0) first = i;
    if (c.eye == "left" && left < 0) left = i;
    if (c.eye == "right" && right < 0) right = i;
  }
  return left >= 0 && right >= 0 ? std::vector{left, right} : std::vector{first};
}

// Before the long work also by the names of objects; empty without a file.
Result<runtime::ObjectTrack> read_moves(const std::string& file, const runtime::Scene& scene) {
  if (file.empty()) return runtime::ObjectTrack{};
  PENUMBRA_ASSIGN(track, runtime::read_object_track(file));
  for (const runtime::ObjectTrack::TrackKey& key : track.keys)
    if (std::ranges::find(scene.objects, key.object, &runtime::SceneObject::name) ==
        scene.objects.end())
      return fail(ErrorCode::kInvalid, file,
                  fmt::format("moves \"{}\", which is no object of the scene", key.object));
  return track;
}

}  // namespace

Result<void> composite(const CompositeOptions& o) {
  if (o.bands < 1 || o.bands > kMaxBands)
    return fail(ErrorCode::kInvalid, "--bands", fmt::format("{} is not within 1..9", o.bands));
  PENUMBRA_ASSIGN(lights, choose_max_lights(o.lights));
  PENUMBRA_TRY(check_max_shadow_error(o.max_shadow_error));
  PENUMBRA_ASSIGN(light, capture::recorded_light(o.light));
  if (!(o.seconds >= 0 && o.seconds < 1e9))
    return fail(ErrorCode::kInvalid, "--seconds", "is not a number of seconds within 0..1e9");
  PENUMBRA_ASSIGN(source, capture::UndamagedFrames::open(o.capture, light, Seconds(o.from_s)));
  PENUMBRA_ASSIGN(scene, runtime::read_scene(o.scene));
  const auto& cameras = source->cameras();
  if (const auto usable = Pipeline::check(cameras); !usable)
    return fail(usable.error().code, o.capture, usable.error().detail);
  // The output is tried before the long work.
  const double rate = source->view_rate();
  PENUMBRA_ASSIGN(folder, OutputFolder::create(o.output));
  PipelineOptions options;
  options.bands = o.bands;
  options.max_lights = lights.max_count;
  options.max_shadow_error = o.max_shadow_error;
  options.progress = progress_bar;
  if (o.coarse) options.bake = runtime::BakeSettings::coarse();
  PENUMBRA_ASSIGN(track, read_moves(o.moves, scene));
  PENUMBRA_ASSIGN(pipeline, Pipeline::create(cameras, scene, options));
  PENUMBRA_TRY(pipeline.follow(track));
  const std::atomic<bool>& stop = catch_stop_signals();
  PENUMBRA_TRY(folder.begin());
  const std::vector<int> in_video = cameras_in_video(cameras);
  PENUMBRA_ASSIGN(
      writer, FrameWriter::create({folder.work(), o.stills, o.video, rate > 0 ? rate : 30, false,
                                   static_cast<int>(in_video.size())},
                                  pipeline.timings()));

  const auto view = std::ranges::find(cameras, capture::Role::kView, &capture::CameraInfo::role);
  runtime::EyeMoments moments(cameras, Seconds(rate > 0 ? 1 / rate : 0));
  const auto write = [&](const runtime::Output& out) {
    const bool first = out.source.camera == view - cameras.begin();
    const auto camera = static_cast<std::size_t>(out.source.camera);
    const std::string name = still_name(cameras[camera], first, moments.number(out.source));
    const auto eye = std::ranges::find(in_video, out.source.camera);
    std::optional<FrameWriter::InVideo> place;
    if (eye != in_video.end()) place = {out.source.time, static_cast<int>(eye - in_video.begin())};
    return writer->write(name, out.pixels, place) && !stop;
  };
  PartOfCapture part(*source, Seconds(o.seconds));
  auto replayed = pipeline.replay(part, write);
  if (!replayed && o.from_s > 0 && part.has_no_picture())
    return fail(ErrorCode::kInvalid, "--from",
                fmt::format("{} s is behind the last picture of {}", o.from_s, o.capture));
  PENUMBRA_ASSIGN(counts, replayed);
  if (stop) return stopped(o.output);
  PENUMBRA_TRY(writer->finish());
  const nlohmann::json summary =
      summarise(counts, pipeline.timings(),
                {o.bands, view->projection.width, view->projection.height,
                 static_cast<int>(pipeline.scene().objects.size()), pipeline.output().renderer()});
  PENUMBRA_TRY(write_bytes(folder.file("summary.json"), summary.dump(2) + "\n"));
  PENUMBRA_TRY(folder.keep(OutputFolder::EarlierFrames::kGo));
  if (o.json)
    print_json(summary);
  else
    print_summary(summary);
  return {};
}

void add_composite(CLI::App& parent, Action& action) {
  static CompositeOptions composite_options;
  auto* c = parent.add_subcommand(
      "composite",
      "Replay a recording or a capture folder through the whole pipeline, to the same bytes each "
      "time");
  c->add_option("--capture", composite_options.capture, "Recording or capture folder to replay")
      ->required();
  c->add_option("--scene", composite_options.scene, "Scene to composite, scene.toml")->required();
  c->add_option("--out", composite_options.output,
                "Folder for the frames, the video and the summary")
      ->required();
  c->add_option("--from", composite_options.from_s,
                "Begin so many seconds after the first frame; the light is read from two seconds "
                "before");
  c->add_option("--seconds", composite_options.seconds,
                "End so many seconds behind the first picture; 0: at the end");
  c->add_option(
      "--moves", composite_options.moves,
      "Places of objects over time, a CSV file with the columns "
      "time_s,object,x_m,y_m,z_m,turn_deg and, where one leans, lean_deg,lean_towards_deg");
  c->add_option("--bands", composite_options.bands, kMaxBandsHelp)->capture_default_str();
  c->add_option("--light", composite_options.light,
                "Where a recording's light is taken from: cameras, track (maps that were measured "
                "while it was recorded), or auto: cameras where it has any")
      ->capture_default_str();
  c->add_option("--max-lights", composite_options.lights, kMaxLightsHelp)->capture_default_str();
  c->add_option("--max-shadow-error", composite_options.max_shadow_error, kMaxShadowErrorHelp)
      ->capture_default_str();
  c->add_flag("--coarse", composite_options.coarse,
              "Bake as the demo does without --fine: in seconds, with coarser shadows on objects");
  auto* no_video = c->add_flag("!--no-video", composite_options.video, "Write no video");
  c->add_flag("!--no-stills", composite_options.stills,
              "Write no stills, which take most of the time")
      ->excludes(no_video);
  add_json(c, composite_options.json);
  c->callback([&] { action = [] { return composite(composite_options); }; });
}

}  // namespace penumbra::tools
