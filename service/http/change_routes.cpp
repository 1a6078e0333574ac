// What clients change: PATCH, POST, DELETE. Bodies are JSON and say so, which no foreign page can
// send without being asked first.
#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>

#include "codec/codec.h"
#include "codec/display.h"
#include "service/http/internal/context.h"

namespace penumbra::service {

using httplib::Request;
using httplib::Response;
using nlohmann::json;

namespace {

// Answers itself where there is none.
bool has_json(const Request& q, Response& r) {
  std::string type = lower(q.get_header_value("Content-Type"));
  type.erase(std::min(type.size(), type.find_first_of("; \t")));
  if (type == "application/json") return true;
  reply(r, {{"error", "the body must be application/json"}}, 415);
  return false;
}

// The one value that a body may hold; null where it is left out.
Result<json> only_value(const std::string& body, const std::string& key) {
  const json all = json::parse(body, nullptr, false);
  if (!all.is_object()) return fail(ErrorCode::kInvalid, "the body", "is no JSON object");
  for (const auto& item : all.items())
    if (item.key() != key)
      return fail(ErrorCode::kInvalid, item.key(), fmt::format("is no key here: {} is", key));
  return all.value(key, json(nullptr));
}

void patch_object(HttpContext& context, const Request& q, Response& r) {
  if (!has_json(q, r)) return;
  const auto change = read_object_change(q.body);
  if (!change) return refuse(r, change.error());
  SceneControl& objects = context.sources.objects;
  if (const auto done = objects.change(q.matches[1].str(), *change); !done)
    return refuse(r, done.error());
  reply(r, {{"objects", objects.objects()}});
}

void add_object(HttpContext& context, const Request& q, Response& r) {
  if (!has_json(q, r)) return;
  const auto object = read_new_object(q.body, context.options.assets);
  if (!object) return refuse(r, object.error());
  if (const auto added = context.sources.objects.add(*object); !added)
    return refuse(r, added.error());
  reply(r, {{"preparing", object->name}}, 202);
}

// A number of a path; more than there can be where it is none.
std::size_t number_in(const Request& q) {
  const std::string text = q.matches[1].str();
  return text.size() > 6 ? std::size_t{1'000'000} : std::strtoul(text.c_str(), nullptr, 10);
}

void reply_with_scene(HttpContext& context, const Result<void>& done, Response& r, int status) {
  if (!done) return refuse(r, done.error());
  reply(r, context.sources.objects.surroundings(), status);
}

void show_scene(HttpContext& context, const Request& q, Response& r) {
  if (!has_json(q, r)) return;
  const auto value = only_value(q.body, "file");
  if (!value) return refuse(r, value.error());
  if (!value->is_string()) return refuse(r, {ErrorCode::kInvalid, "file", "is not a text"});
  const auto file = scene_file_in(context.options.assets, value->get<std::string>());
  if (!file) return refuse(r, file.error());
  const auto scene = runtime::read_scene(*file);
  if (!scene) return refuse(r, scene.error());
  reply_with_scene(context, context.sources.objects.show_scene(*scene, *file), r, 202);
}

void change_budget(HttpContext& context, const Request& q, Response& r) {
  if (!has_json(q, r)) return;
  const auto value = only_value(q.body, "max_shadow_error");
  if (!value) return refuse(r, value.error());
  if (!value->is_number())
    return refuse(r, {ErrorCode::kInvalid, "max_shadow_error", "is not a number"});
  SceneControl& objects = context.sources.objects;
  if (const auto done = objects.set_max_shadow_error(value->get<double>()); !done)
    return refuse(r, done.error());
  reply(r, {{"max_shadow_error", value->get<double>()}});
}

Result<std::vector<double>> numbers_of(const json& all, const char* key) {
  std::vector<double> out;
  const json list = all.value(key, json::array());
  if (!list.is_array()) return fail(ErrorCode::kInvalid, key, "is no list of numbers");
  for (const json& value : list) {
    if (!value.is_number()) return fail(ErrorCode::kInvalid, key, "is no list of numbers");
    out.push_back(value.get<double>());
  }
  return out;
}

Result<std::vector<Exposure>> read_exposures(const std::string& body) {
  const json all = json::parse(body, nullptr, false);
  if (!all.is_object()) return fail(ErrorCode::kInvalid, "the body", "is no JSON object");
  for (const auto& item : all.items())
    if (item.key() != "exposures_s" && item.key() != "gains")
      return fail(ErrorCode::kInvalid, item.key(), "is no key here: exposures_s and gains are");
  PENUMBRA_ASSIGN(times, numbers_of(all, "exposures_s"));
  PENUMBRA_ASSIGN(gains, numbers_of(all, "gains"));
  if (all.contains("gains") && gains.empty()) return fail(ErrorCode::kInvalid, "gains", "are none");
  return capture::exposures_of(times, gains);
}

void set_exposures(HttpContext& context, const Request& q, Response& r) {
  if (!has_json(q, r)) return;
  const auto exposures = read_exposures(q.body);
  if (!exposures) return refuse(r, exposures.error());
  const std::string camera = q.matches[1].str();
  if (const auto done = context.sources.cameras.set_exposures(camera, *exposures); !done)
    return refuse(r, done.error());
  json body = {{"camera", camera}, {"exposures_s", json::array()}, {"gains", json::array()}};
  for (const Exposure& e : *exposures) {
    body["exposures_s"].push_back(e.time.count());
    body["gains"].push_back(e.gain.value());
  }
  reply(r, body, 202);
}

struct RecordingWanted {
  std::string file;
  runtime::KeptLight light = runtime::KeptLight::kCameras;
};
Result<RecordingWanted> read_recording(const std::string& body) {
  const json all = json::parse(body, nullptr, false);
  if (!all.is_object()) return fail(ErrorCode::kInvalid, "the body", "is no JSON object");
  RecordingWanted out;
  for (const auto& [key, value] : all.items()) {
    if (key != "file" && key != "light")
      return fail(ErrorCode::kInvalid, key, "is no key here: file and light are");
    if (value.is_null()) continue;
    if (!value.is_string()) return fail(ErrorCode::kInvalid, key, "is not a text");
    if (key == "file") {
      out.file = value.get<std::string>();
      continue;
    }
    const auto light = runtime::kept_light(value.get<std::string>());
    if (!light) return fail(ErrorCode::kInvalid, key, light.error().detail);
    out.light = *light;
  }
  return out;
}

void start_recording(HttpContext& context, const Request& q, Response& r) {
  if (!has_json(q, r)) return;
  const auto wanted = read_recording(q.body);
  if (!wanted) return refuse(r, wanted.error());
  const auto started = context.sources.recording.start(wanted->file, wanted->light);
  if (!started) return refuse(r, started.error());
  reply(r, {{"file", *started}}, 201);
}

void take_snapshot(HttpContext& context, const Request& q, Response& r) {
  if (!has_json(q, r)) return;
  const json body = json::parse(q.body, nullptr, false);
  if (!body.is_object() || !body.empty())
    return refuse(r, {ErrorCode::kInvalid, "the body", "is not {}"});
  const auto s = context.sources.state.snapshot();
  if (!s.frame) return reply(r, {{"error", "no frame has been composited yet"}}, 503);
  const auto file = context.sources.recording.new_file("snapshot", ".png");
  if (!file) return refuse(r, file.error());
  if (const auto written = codec::write_frame(*file, codec::to_display(*s.frame)); !written)
    return refuse(r, written.error());
  reply(r, {{"file", file->filename().string()}}, 201);
}

}  // namespace

void add_change_routes(httplib::Server& server, HttpContext& context) {
  server.Patch("/v1/objects/(.+)",
               [&](const Request& q, Response& r) { patch_object(context, q, r); });
  server.Post("/v1/objects", [&](const Request& q, Response& r) { add_object(context, q, r); });
  server.Delete("/v1/objects/(.+)", [&](const Request& q, Response& r) {
    const std::string name = q.matches[1].str();
    if (const auto gone = context.sources.objects.remove(name); !gone)
      return refuse(r, gone.error());
    reply(r, {{"removed", name}});
  });
  SceneControl& objects = context.sources.objects;
  server.Put("/v1/scene", [&](const Request& q, Response& r) { show_scene(context, q, r); });
  server.Post("/v1/lamps", [&](const Request& q, Response& r) {
    if (has_json(q, r)) reply_with_scene(context, objects.add_lamp(q.body), r, 202);
  });
  server.Patch(R"(/v1/lamps/(\d+))", [&](const Request& q, Response& r) {
    if (has_json(q, r))
      reply_with_scene(context, objects.change_lamp(number_in(q), q.body), r, 202);
  });
  server.Delete(R"(/v1/lamps/(\d+))", [&](const Request& q, Response& r) {
    reply_with_scene(context, objects.remove_lamp(number_in(q)), r, 202);
  });
  server.Patch("/v1/budget", [&](const Request& q, Response& r) { change_budget(context, q, r); });
  server.Put("/v1/cameras/(.+)/exposures",
             [&](const Request& q, Response& r) { set_exposures(context, q, r); });
  server.Delete("/v1/cameras/(.+)/exposures", [&](const Request& q, Response& r) {
    const std::string camera = q.matches[1].str();
    if (const auto done = context.sources.cameras.set_exposures(camera, {}); !done)
      return refuse(r, done.error());
    reply(r, {{"camera", camera}}, 202);
  });
  server.Post("/v1/recording",
              [&](const Request& q, Response& r) { start_recording(context, q, r); });
  server.Delete("/v1/recording", [&](const Request&, Response& r) {
    const auto stopped = context.sources.recording.stop();
    if (!stopped) return refuse(r, stopped.error());
    reply(r, to_json(*stopped));
  });
  server.Post("/v1/snapshot", [&](const Request& q, Response& r) { take_snapshot(context, q, r); });
}

}  // namespace penumbra::service
