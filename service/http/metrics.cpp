// The text format of Prometheus: base units, counters that only grow.
#include <fmt/format.h>
#include <unistd.h>

#include <ctime>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "service/http/internal/context.h"

namespace penumbra::service {

namespace {

// One metric after the other, each with its help and type.
class Metrics {
 public:
  void begin(std::string_view name, std::string_view type, std::string_view help) {
    name_ = name;
    fmt::format_to(std::back_inserter(text_), "# HELP {} {}\n# TYPE {} {}\n", name, help, name,
                   type);
  }
  void add(double value, std::string_view labels = "", std::string_view suffix = "") {
    fmt::format_to(std::back_inserter(text_), "{}{}{}{}{} {:.10g}\n", name_, suffix,
                   labels.empty() ? "" : "{", labels, labels.empty() ? "" : "}", value);
  }
  void gauge(std::string_view name, std::string_view help, double value) {
    begin(name, "gauge", help);
    add(value);
  }
  void counter(std::string_view name, std::string_view help, double value) {
    begin(name, "counter", help);
    add(value);
  }
  std::string take() { return std::move(text_); }

 private:
  std::string name_, text_;
};

// A label's value, as the format wants it.
std::string quoted(const std::string& value) {
  std::string out;
  for (const char c : value) {
    if (c == '\n')
      out += "\\n";
    else if (c == '"' || c == '\\')
      (out += '\\') += c;
    else
      out += c;
  }
  return out;
}

void add_frames(const PublishedState::Snapshot& s, Metrics& m) {
  m.counter("penumbra_frames_composited_total", "View frames handed out.",
            static_cast<double>(s.frames));
  m.begin("penumbra_frames_overtaken_total", "counter", "Frames that newer ones overtook.");
  m.add(static_cast<double>(s.overtaken.view), "queue=\"view\"");
  m.add(static_cast<double>(s.overtaken.environment), "queue=\"environment\"");
  m.add(static_cast<double>(s.overtaken.foreground), "queue=\"foreground\"");
  m.add(static_cast<double>(s.overtaken.for_light), "queue=\"for_light\"");
  m.begin("penumbra_eyes_unmatched_total", "counter",
          "Eyes of a stereo rig whose other one did not come.");
  m.add(static_cast<double>(s.overtaken.unmatched_eyes));
  m.gauge("penumbra_frame_rate_hertz", "View frames a second over two seconds.", s.frame_rate_hz);
  m.gauge("penumbra_source_frame_rate_hertz", "View frames a second that the source sends.",
          s.view_rate_hz);
}

void add_cameras(const PublishedState::Snapshot& s, Metrics& m) {
  m.begin("penumbra_camera_frames_total", "counter",
          "Frames of real cameras by what became of them.");
  for (const auto& [name, c] : s.cameras)
    for (const auto& [result, count] : {std::pair{"delivered", c.frames},
                                        {"lost", c.lost},
                                        {"damaged", c.damaged},
                                        {"rejected", c.rejected},
                                        {"overrun", c.overrun}})
      m.add(static_cast<double>(count),
            fmt::format("camera=\"{}\",result=\"{}\"", quoted(name), result));
  m.begin("penumbra_camera_reconnects_total", "counter", "How often a camera came back.");
  for (const auto& [name, c] : s.cameras)
    m.add(static_cast<double>(c.reconnected), fmt::format("camera=\"{}\"", quoted(name)));
  m.begin("penumbra_camera_follows_exposure", "gauge",
          "0 where pictures do not follow the exposures that the camera is asked for.");
  for (const auto& [name, c] : s.cameras)
    m.add(c.ignores_controls ? 0 : 1, fmt::format("camera=\"{}\"", quoted(name)));
}

void add_light(const PublishedState::Snapshot& s, std::optional<double> budget, Metrics& m) {
  m.gauge("penumbra_light_valid", "1 once a light has been measured.", s.light.valid ? 1 : 0);
  if (budget)
    m.gauge("penumbra_budget_shadow_error_ratio", "RMS error of the shadow ratio that is allowed.",
            *budget);
  if (!s.light.valid) return;
  m.gauge("penumbra_light_age_seconds", "Age of the light.", s.light_age_s());
  m.gauge("penumbra_light_coverage_ratio", "Part of the sphere that the cameras show.",
          s.light.coverage);
  m.gauge("penumbra_light_clipped_ratio", "Part of the sphere that is saturated in every exposure.",
          s.light.clipped_fraction);
  if (s.light.uncertainty.total)
    m.gauge("penumbra_light_uncertainty_ratio",
            "One standard deviation of the irradiance, relative to its mean.",
            *s.light.uncertainty.total);
  m.gauge("penumbra_distant_lights", "Distant lights in the light.",
          static_cast<double>(s.light.lights.size()));
  if (!s.light.plan) return;
  const lighting::Plan& p = *s.light.plan;
  m.gauge("penumbra_light_lower_bound",
          "1 while a light is saturated in every exposure and not recovered: the error is unknown.",
          p.lower_bound ? 1 : 0);
  if (!p.lower_bound) {
    m.gauge("penumbra_predicted_shadow_error_ratio", "Predicted RMS error of the shadow ratio.",
            p.error);
    m.gauge("penumbra_predicted_object_error_ratio",
            "Predicted RMS error of the objects' radiance, relative.", p.object_error);
  }
  m.gauge("penumbra_budget_kept", "1 while the plan keeps to the budget.", p.within_budget ? 1 : 0);
  m.gauge("penumbra_plan_bands", "Bands of spherical harmonics in the plan.", p.bands);
  m.gauge("penumbra_plan_lights", "Distant lights that are traced.", p.lights);
}

void add_stages(const StageTimes& times, Metrics& m) {
  using Histogram = StageTimes::Histogram;
  m.begin("penumbra_stage_seconds", "histogram", "How long stages of a frame take.");
  for (const auto& [stage, h] : times.histograms()) {
    const std::string label = fmt::format("stage=\"{}\"", quoted(stage));
    double up_to_here = 0;
    for (std::size_t i = 0; i < Histogram::kUpTo_ms.size(); ++i) {
      up_to_here += static_cast<double>(h.counts[i]);
      m.add(up_to_here, fmt::format("{},le=\"{:g}\"", label, Histogram::kUpTo_ms[i] / 1e3),
            "_bucket");
    }
    m.add(static_cast<double>(h.count), label + ",le=\"+Inf\"", "_bucket");
    m.add(h.sum_ms / 1e3, label, "_sum");
    m.add(static_cast<double>(h.count), label, "_count");
  }
}

void add_outputs(const PublishedState::Snapshot& s, Metrics& m) {
  m.begin("penumbra_output_frames_total", "counter", "Frames of an output by what became of them.");
  for (const PublishedState::OutputState& o : s.outputs) {
    const std::string label = fmt::format("output=\"{}\"", quoted(o.name));
    m.add(static_cast<double>(o.shown), label + ",result=\"shown\"");
    m.add(static_cast<double>(o.overtaken), label + ",result=\"overtaken\"");
  }
  m.begin("penumbra_output_works", "gauge", "0 while nothing comes out of an output.");
  for (const PublishedState::OutputState& o : s.outputs)
    m.add(o.trouble.empty() ? 1 : 0, fmt::format("output=\"{}\"", quoted(o.name)));
}

void add_pose(const PublishedState::Snapshot& s, Metrics& m) {
  if (!s.pose) return;
  m.begin("penumbra_poses_total", "counter", "Poses of the source by what became of them.");
  m.add(static_cast<double>(s.pose->accepted), "result=\"accepted\"");
  m.add(static_cast<double>(s.pose->rejected), "result=\"rejected\"");
  m.gauge("penumbra_pose_opacity", "Opacity of what is virtual: below 1 while its pose is old.",
          s.pose->opacity);
}

void add_headset(const PublishedState::Snapshot& s, Metrics& m) {
  if (!s.headset) return;
  m.begin("penumbra_headset_pictures_total", "counter",
          "Pictures for the headset by what became of them.");
  m.add(static_cast<double>(s.headset->shown), "result=\"shown\"");
  m.add(static_cast<double>(s.headset->overtaken), "result=\"overtaken\"");
  m.add(static_cast<double>(s.headset->unmatched), "result=\"unmatched\"");
  m.add(static_cast<double>(s.headset->unplaced), "result=\"unplaced\"");
  m.gauge("penumbra_headset_running", "1 while the headset shows pictures.",
          s.headset->phase == "running" ? 1 : 0);
}

void add_process(Metrics& m) {
  double pages = 0, resident_pages = 0;
  std::ifstream("/proc/self/statm") >> pages >> resident_pages;
  m.gauge("process_resident_memory_bytes", "Resident memory.",
          resident_pages * static_cast<double>(::sysconf(_SC_PAGESIZE)));
  std::timespec cpu{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &cpu);
  m.counter("process_cpu_seconds_total", "Processor time of all threads.",
            static_cast<double>(cpu.tv_sec) + static_cast<double>(cpu.tv_nsec) * 1e-9);
  const auto entries = [](const char* folder) {
    std::error_code error;
    const std::filesystem::directory_iterator first(folder, error);
    return static_cast<double>(error ? 0 : std::distance(begin(first), end(first)));
  };
  m.gauge("process_open_fds", "Open file descriptors.", entries("/proc/self/fd"));
  m.gauge("process_threads", "Threads.", entries("/proc/self/task"));
}

}  // namespace

std::string metrics_text(HttpContext& context) {
  const auto s = context.sources.state.snapshot();
  Metrics m;
  m.begin("penumbra_build_info", "gauge", "Always 1; the version is a label.");
  m.add(1, fmt::format("version=\"{}\"", PENUMBRA_VERSION));
  m.gauge("penumbra_uptime_seconds", "Time since the start.", s.uptime_s);
  add_frames(s, m);
  add_cameras(s, m);
  add_light(s, context.sources.objects.max_shadow_error(), m);
  add_stages(context.sources.times, m);
  add_outputs(s, m);
  add_pose(s, m);
  add_headset(s, m);
  m.gauge("penumbra_streams", "Streams that are open.", context.streams);
  if (const auto recording = context.sources.recording.state()) {
    const auto r = to_json(*recording);
    m.gauge("penumbra_recording_active", "1 while frames are recorded.", recording->active ? 1 : 0);
    m.gauge("penumbra_recording_dropped_frames", "Frames that the recording left out.",
            r["dropped"].get<double>());
  }
  m.gauge("penumbra_objects_missing", "Objects that could not be loaded.",
          static_cast<double>(context.sources.objects.faults().size()));
  add_process(m);
  return m.take();
}

}  // namespace penumbra::service
