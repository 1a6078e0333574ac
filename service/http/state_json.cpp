#include <algorithm>
#include <cmath>

#include "runtime/pipeline/report.h"
#include "service/http/internal/context.h"

namespace penumbra::service {

using nlohmann::json;

namespace {

json to_json(const capture::CameraCounts& c) {
  json out = {{"frames", c.frames},
              {"lost", c.lost},
              {"damaged", c.damaged},
              {"rejected", c.rejected},
              {"overrun", c.overrun},
              {"reconnected", c.reconnected},
              {"follows_exposure", !c.ignores_controls}};
  out["delay_frames"] = c.delay_frames ? json(*c.delay_frames) : json(nullptr);
  out["exposures_s"] = json::array();
  out["gains"] = json::array();
  for (const Exposure& e : c.exposures) {
    out["exposures_s"].push_back(e.time.count());
    out["gains"].push_back(e.gain.value());
  }
  if (c.light_error) out["light_error"] = *c.light_error;
  return out;
}

json cameras_json(const PublishedState::Snapshot& s) {
  json out = json::object();
  for (const auto& [name, counts] : s.cameras) out[name] = to_json(counts);
  return out;
}

// Work that goes on, and objects that wait for it.
json preparing_json(const PublishedState::Snapshot& s, const SceneControl& objects) {
  json out = json::object();
  for (const std::string& name : objects.awaited()) out[name] = 0;
  for (const auto& [work, done] : s.preparing) out[work] = std::round(1e4 * done) / 1e4;
  return out;
}

json pose_json(const PublishedState::PoseState& p) {
  const auto known = [](const std::optional<double>& v) { return v ? json(*v) : json(nullptr); };
  return {{"source", p.name},
          {"age_s", known(p.age_s)},
          {"accepted", p.accepted},
          {"rejected", p.rejected},
          {"left_out", p.left_out},
          {"opacity", p.opacity},
          {"sigma_mm", known(p.sigma_mm)},
          {"sigma_deg", known(p.sigma_deg)},
          {"extrapolated_ms", known(p.extrapolated_ms)},
          {"trouble", p.trouble}};
}

json headset_json(const PublishedState::HeadsetView& h) {
  json out = {{"phase", h.phase},         {"runtime", h.runtime},   {"headset", h.headset},
              {"rate_hz", h.rate_hz},     {"shown", h.shown},       {"overtaken", h.overtaken},
              {"unmatched", h.unmatched}, {"unplaced", h.unplaced}, {"rejected", h.rejected},
              {"restarts", h.restarts},   {"trouble", h.trouble},   {"latency", json::object()}};
  for (const auto& [name, p] : h.latency)
    out["latency"][name] = {{"p50_ms", p.p50_ms}, {"p99_ms", p.p99_ms}, {"count", p.count}};
  return out;
}

}  // namespace

json health_json(HttpContext& context) {
  const auto s = context.sources.state.snapshot();
  json body = {{"status", s.status(context.options.stale_after_s)},
               {"frames", s.frames},
               {"frame_rate_hz", s.frame_rate_hz},
               {"dropped", runtime::to_json(s.overtaken)},
               {"stages", context.stages.now()}};
  if (json work = preparing_json(s, context.sources.objects); !work.empty())
    body["preparing"] = std::move(work);
  if (!s.cameras.empty()) body["cameras"] = cameras_json(s);
  if (s.pose) body["pose"] = pose_json(*s.pose);
  if (s.headset) body["headset"] = headset_json(*s.headset);
  if (json faults = context.sources.objects.faults(); !faults.empty()) body["faults"] = faults;
  return body;
}

json light_json(const PublishedState::Snapshot& s, double stale_after_s) {
  json body = runtime::to_json(s.light);
  body["time_ns"] = s.light.time.value;
  body["age_s"] = s.light_age_s();
  body["valid"] = s.light.valid;
  body["status"] = s.status(stale_after_s);
  body["units"] =
      "linear Rec.709, relative radiance; basis and index: real SH without Condon-Shortley "
      "phase, l*l+l+m, z the pole of a y-up world";
  return body;
}

json to_json(const RecordingState& r) {
  const auto sum = [](const std::vector<std::uint64_t>& of_cameras) {
    std::uint64_t out = 0;
    for (const std::uint64_t n : of_cameras) out += n;
    return out;
  };
  json out = {{"file", r.file},
              {"active", r.active},
              {"frames", sum(r.counts.frames)},
              {"dropped", sum(r.counts.dropped) + r.overrun},
              {"bytes", r.counts.bytes},
              {"seconds", r.counts.seconds}};
  if (!r.error.empty()) out["error"] = r.error;
  return out;
}

json state_json(HttpContext& context) {
  const auto s = context.sources.state.snapshot();
  json body = {{"status", s.status(context.options.stale_after_s)},
               {"version", PENUMBRA_VERSION},
               {"uptime_s", s.uptime_s},
               {"frames", s.frames},
               {"frame_rate_hz", s.frame_rate_hz},
               {"view_rate_hz", s.view_rate_hz},
               {"dropped", runtime::to_json(s.overtaken)},
               {"stages", context.stages.now()},
               {"preparing", preparing_json(s, context.sources.objects)},
               {"cameras", cameras_json(s)},
               {"faults", context.sources.objects.faults()},
               {"objects", context.sources.objects.objects()}};
  body["light"] = s.light.valid ? light_json(s, context.options.stale_after_s) : json(nullptr);
  const auto budget = context.sources.objects.max_shadow_error();
  body["budget"] = budget ? json{{"max_shadow_error", *budget}} : json(nullptr);
  body["outputs"] = json::array();
  for (const PublishedState::OutputState& o : s.outputs)
    body["outputs"].push_back(
        {{"name", o.name}, {"shown", o.shown}, {"overtaken", o.overtaken}, {"trouble", o.trouble}});
  body["pose"] = s.pose ? pose_json(*s.pose) : json(nullptr);
  body["headset"] = s.headset ? headset_json(*s.headset) : json(nullptr);
  const auto recording = context.sources.recording.state();
  body["recording"] = recording ? to_json(*recording) : json(nullptr);
  return body;
}

}  // namespace penumbra::service
