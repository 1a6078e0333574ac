// What clients read: GET.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "core/conventions.h"
#include "runtime/pipeline/report.h"
#include "service/http/internal/context.h"
#include "service/http/light_conventions.h"

namespace penumbra::service {

using httplib::Request;
using httplib::Response;
using nlohmann::json;

namespace {

json to_json(const glm::dvec3& v) {
  return {v.x, v.y, v.z};
}

void no_light_yet(Response& r) {
  reply(r, {{"error", "no light has been measured yet"}}, 503);
}

void no_frame_yet(Response& r) {
  reply(r, {{"error", "no frame has been composited yet"}}, 503);
}

// The capture time of what has no room for it: a map has that of its light.
void tell_time(TimestampNs time, Response& r) {
  r.set_header("Penumbra-Time-Ns", std::to_string(time.value));
}

// Its bytes are those of all who ask, not copied for each.
void reply_with_file(Response& r, const char* type, const Result<EncodedFile>& file) {
  if (!file) return refuse(r, file.error());
  tell_time(file->time, r);
  r.set_content_provider(
      file->bytes->size(), type,
      [bytes = file->bytes](std::size_t offset, std::size_t length, httplib::DataSink& sink) {
        return sink.write(bytes->data() + offset, length);
      });
}

void get_light(HttpContext& context, const Request& q, Response& r) {
  const auto s = context.sources.state.snapshot();
  if (!s.light.valid) return no_light_yet(r);
  tell_time(s.light.time, r);
  if (!q.has_param("as")) return reply(r, light_json(s, context.options.stale_after_s));
  auto light = light_as(s.light, q.get_param_value("as"));
  if (!light) return refuse(r, light.error());
  (*light)["time_ns"] = s.light.time.value;
  (*light)["age_s"] = s.light_age_s();
  reply(r, *light);
}

// Solid angle by stops of luminance, of what is seen.
json histogram_of(const Environment& map) {
  constexpr int kFirst = -12, kBins = 32;
  std::array<double, kBins> bins{};
  const Image<Rgb>& radiance = map.radiance;
  double all = 0;
  for (int y = 0; y < radiance.height(); ++y) {
    const double weight = std::sin(kPi * (y + .5) / radiance.height());
    for (int x = 0; x < radiance.width(); ++x) {
      if (!map.confidence.empty() && map.confidence.at(x, y) <= 0) continue;
      const double stops = std::log2(std::max(1e-30f, luminance(radiance.at(x, y))));
      const int bin = std::clamp(static_cast<int>(std::floor(stops)) - kFirst, 0, kBins - 1);
      bins[static_cast<std::size_t>(bin)] += weight;
      all += weight;
    }
  }
  json fraction = json::array();
  for (const double b : bins) fraction.push_back(all > 0 ? b / all : 0);
  return {{"first_log2", kFirst}, {"step_log2", 1}, {"fraction", fraction}};
}

void get_environment(HttpContext& context, const std::string& kind, Response& r) {
  const auto map = context.sources.state.environment();
  if (!map) return no_light_yet(r);
  EnvironmentFiles& files = context.environment_files;
  if (kind == ".jpg") return reply_with_file(r, "image/jpeg", files.jpeg(map));
  if (kind == ".ktx") return reply_with_file(r, "image/ktx", files.cube(map));
  if (kind == ".exr") return reply_with_file(r, "image/x-exr", files.exr(map));
  if (kind == ".hdr") return reply_with_file(r, "image/vnd.radiance", files.hdr(map));
  tell_time(map->time, r);
  const auto s = context.sources.state.snapshot();
  reply(r, {{"width", map->radiance.width()},
            {"height", map->radiance.height()},
            {"time_ns", map->time.value},
            {"age_s", std::max(0., (s.now - map->time).count()) + s.idle_s},
            {"coverage", s.light.coverage},
            {"clipped_fraction", map->clipped_fraction},
            {"black_fraction", map->black_fraction},
            {"histogram", histogram_of(*map)}});
}

void get_frame(HttpContext& context, const std::string& kind, Response& r) {
  const auto s = context.sources.state.snapshot();
  if (!s.frame) return no_frame_yet(r);
  if (kind == ".png")
    return reply_with_file(r, "image/png", context.frame_files.png(s.frame, s.now));
  reply_with_file(r, "image/jpeg", context.frame_files.jpeg(s.frame, s.now));
}

json view_json(const PublishedState::Snapshot& s) {
  const auto view = std::ranges::find(s.sources, capture::Role::kView, &capture::CameraInfo::role);
  if (view == s.sources.end()) return nullptr;
  const calib::CameraModel& p = view->projection;
  const Pose& pose = view->world_from_camera;
  const glm::dquat& q = pose.rotation;
  return {
      {"name", view->name},
      {"width", p.width},
      {"height", p.height},
      {"focal_px", {p.focal_px.x, p.focal_px.y}},
      {"centre_px", {p.principal_px.x, p.principal_px.y}},
      {"world_from_camera",
       {{"rotation_wxyz", {q.w, q.x, q.y, q.z}}, {"translation_m", to_json(pose.translation)}}}};
}

json sources_json(const PublishedState::Snapshot& s) {
  json out = json::array();
  for (const capture::CameraInfo& c : s.sources)
    out.push_back({{"name", c.name},
                   {"role", capture::role_name(c.role)},
                   {"width", c.projection.width},
                   {"height", c.projection.height}});
  return out;
}

}  // namespace

void add_read_routes(httplib::Server& server, HttpContext& context) {
  server.Get("/healthz", [&](const Request&, Response& r) {
    const json body = health_json(context);
    reply(r, body, body["status"] == "ok" || body["status"] == "slow" ? 200 : 503);
  });
  server.Get("/metrics", [&](const Request&, Response& r) {
    r.set_content(metrics_text(context), "text/plain; version=0.0.4; charset=utf-8");
  });
  server.Get("/v1/light", [&](const Request& q, Response& r) { get_light(context, q, r); });
  server.Get(R"(/v1/environment(\.exr|\.hdr|\.jpg|\.ktx)?)", [&](const Request& q, Response& r) {
    get_environment(context, q.matches[1].str(), r);
  });
  server.Get(R"(/v1/frame(\.jpg|\.png))",
             [&](const Request& q, Response& r) { get_frame(context, q.matches[1].str(), r); });
  server.Get("/v1/stages", [&](const Request&, Response& r) {
    reply(r, {{"stages", context.stages.now()}});
  });
  server.Get("/v1/cameras", [&](const Request&, Response& r) {
    json body = {{"sources", sources_json(context.sources.state.snapshot())}};
    body["cameras"] = health_json(context).value("cameras", json::object());
    reply(r, body);
  });
  server.Get("/v1/scene", [&](const Request&, Response& r) {
    json body = context.sources.objects.surroundings();
    body["view"] = view_json(context.sources.state.snapshot());
    reply(r, body);
  });
  server.Get("/v1/state", [&](const Request&, Response& r) { reply(r, state_json(context)); });
  server.Get("/v1/objects", [&](const Request&, Response& r) {
    const json all = context.sources.objects.objects();
    if (all.is_null()) return reply(r, {{"error", "the service is still starting"}}, 503);
    reply(r, {{"objects", all}});
  });
}

}  // namespace penumbra::service
