#include <fmt/format.h>
#include <unistd.h>
#include <CLI/CLI.hpp>

#include "capture/frames.h"
#include "core/io/files.h"
#include "core/threads/stop_signal.h"
#include "runtime/pipeline/light_track.h"
#include "runtime/pipeline/report.h"
#include "service/recording/recorder.h"
#include "service/rig_config.h"
#include "service/rig_source.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/penumbra/commands.h"

namespace penumbra::tools {

namespace {

struct RecordOptions {
  std::string config, output, light = "cameras";
  int light_rows = runtime::kLightTrackRows;
  double seconds = 0;  // 0 = until stopped
  int frames = 0;      // of all cameras; 0 = any
  bool json = false;
};

std::string line_of(const std::vector<capture::CameraInfo>& cameras,
                    const service::RecordCounts& counts) {
  std::string text = fmt::format("recorded {:.1f} s", counts.seconds);
  for (std::size_t i = 0; i < counts.frames.size(); ++i) {
    text += fmt::format(", {} {} frames", cameras[i].name, counts.frames[i]);
    const auto tell = [&](std::uint64_t count, const char* what) {
      if (count > 0) text += fmt::format(" ({} {})", count, what);
    };
    tell(counts.faded[i], "without a fresh pose");
    tell(counts.dropped[i], "dropped");
    if (counts.cameras.empty()) continue;
    const capture::CameraCounts& c = counts.cameras[i];
    tell(c.lost, "lost"), tell(c.damaged, "damaged");
    tell(c.rejected, "rejected"), tell(c.overrun, "overrun");
  }
  return text + fmt::format(", {:.1f} MB", static_cast<double>(counts.bytes) / 1e6);
}

nlohmann::json to_json(const std::vector<capture::CameraInfo>& cameras,
                       const service::RecordCounts& counts) {
  nlohmann::json list = nlohmann::json::array();
  for (std::size_t i = 0; i < counts.frames.size(); ++i) {
    const auto c = counts.cameras.empty() ? capture::CameraCounts{} : counts.cameras[i];
    list.push_back({{"name", cameras[i].name},
                    {"frames", counts.frames[i]},
                    {"faded", counts.faded[i]},
                    {"dropped", counts.dropped[i]},
                    {"lost", c.lost},
                    {"damaged", c.damaged},
                    {"rejected", c.rejected},
                    {"overrun", c.overrun}});
  }
  return {{"seconds", counts.seconds}, {"bytes", counts.bytes}, {"cameras", list}};
}

}  // namespace

Result<void> record(const RecordOptions& o) {
  if (!(o.seconds >= 0 && o.seconds < 1e9))
    return fail(ErrorCode::kInvalid, "--seconds", "is not a number of seconds within 0..1e9");
  if (o.frames < 0) return fail(ErrorCode::kInvalid, "--frames", "is negative");
  if (std::filesystem::path(o.output).extension() != ".mkv")
    return fail(ErrorCode::kInvalid, o.output, "does not end in .mkv, as a recording does");
  PENUMBRA_ASSIGN(light, runtime::kept_light(o.light));
  PENUMBRA_ASSIGN(config, service::read_rig_config(o.config, false));
  std::error_code ignored;
  if (std::filesystem::exists(o.output, ignored))
    return fail(ErrorCode::kUnwritable, o.output,
                "exists already: remove it, or choose another name");
  PENUMBRA_TRY(check_writable(o.output));
  PENUMBRA_ASSIGN(rig, service::open_rig(config, progress_bar));
  std::unique_ptr<capture::FrameSource> tracked;
  if (light != runtime::KeptLight::kCameras) {
    PENUMBRA_ASSIGN(made, runtime::with_light_track(*rig.source, light, o.light_rows));
    tracked = std::move(made);
  }
  capture::FrameSource& source = tracked ? *tracked : *rig.source;
  const auto& cameras = source.cameras();
  const bool watched = isatty(STDERR_FILENO);
  const auto tell = [&](const service::RecordCounts& counts) {
    if (watched) std::fprintf(stderr, "\r%s\x1b[K", line_of(cameras, counts).c_str());
  };
  const std::atomic<bool>& stop = catch_stop_signals();
  auto counts = service::record_frames(
      source, o.output, {o.seconds, static_cast<std::uint64_t>(o.frames)}, stop, tell);
  if (watched) std::fputs("\r\x1b[K", stderr);
  PENUMBRA_TRY(counts);
  if (counts->frames.empty()) return stopped(o.output);
  if (o.json)
    print_json(to_json(cameras, *counts));
  else
    std::printf("%s: %s\n", o.output.c_str(), line_of(cameras, *counts).c_str());
  return {};
}

void add_record(CLI::App& parent, Action& action) {
  static RecordOptions record_options;
  auto* c = parent.add_subcommand("record",
                                  "Record the cameras of a rig into a Matroska file, until Ctrl-C");
  c->add_option("--config", record_options.config, "Rig to record, rig.toml")->required();
  c->add_option("--out,-o", record_options.output,
                "Recording to write, .mkv; it must not exist yet")
      ->required();
  c->add_option("--seconds", record_options.seconds,
                "Stop once the frames span this many seconds; 0: no limit");
  c->add_option("--frames", record_options.frames,
                "Stop after this many frames of all cameras together; 0: no limit");
  c->add_option("--light", record_options.light,
                "What is kept of the light: cameras: the frames of the cameras that show the "
                "surroundings; track: maps that are measured from them, a small part of the bytes; "
                "both")
      ->capture_default_str();
  c->add_option("--light-rows", record_options.light_rows,
                "Maximum number of rows of the track's maps, 16..1024; finer ones are averaged")
      ->capture_default_str();
  add_json(c, record_options.json);
  c->callback([&] { action = [] { return record(record_options); }; });
}

}  // namespace penumbra::tools
