#include "service/scene_control.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <numbers>

#include "core/io/spelling.h"

namespace penumbra::service {

namespace {

using nlohmann::json;

constexpr double kDegree = std::numbers::pi / 180;
constexpr std::string_view kChangeKeys[] = {"position_m",  "turn_deg", "visible",
                                            "clip_time_s", "speed",    "blend_weight"};

Result<double> number(const json& value, const std::string& key) {
  constexpr double kMost = 1e6;  // of metres, degrees, seconds
  if (!value.is_number()) return fail(ErrorCode::kInvalid, key, "is not a number");
  if (!(std::abs(value.get<double>()) <= kMost))
    return fail(ErrorCode::kInvalid, key, "is not within -1000000..1000000");
  return value.get<double>();
}

Result<glm::dvec3> position(const json& value, const std::string& key) {
  if (!value.is_array() || value.size() != 3)
    return fail(ErrorCode::kInvalid, key, "is not a list of three numbers");
  glm::dvec3 out;
  for (int i = 0; i < 3; ++i) {
    PENUMBRA_ASSIGN(coordinate, number(value[static_cast<std::size_t>(i)], key));
    out[i] = coordinate;
  }
  return out;
}

Result<void> read_key(const std::string& key, const json& value, ObjectChange& out) {
  if (key == "position_m") {
    PENUMBRA_ASSIGN(p, position(value, key));
    out.position_m = p;
    return {};
  }
  if (key == "visible") {
    if (!value.is_boolean()) return fail(ErrorCode::kInvalid, key, "is neither true nor false");
    out.visible = value.get<bool>();
    return {};
  }
  if (std::ranges::find(kChangeKeys, key) == std::end(kChangeKeys)) {
    const auto near = nearest_word(key, kChangeKeys);
    return fail(ErrorCode::kInvalid, key,
                near ? fmt::format("is no key of an object: did you mean {}?", *near)
                     : "is no key of an object");
  }
  PENUMBRA_ASSIGN(n, number(value, key));
  if (key == "turn_deg") out.turn_deg = n;
  if (key == "clip_time_s") out.playback.clip_time_s = n;
  if (key == "speed") out.playback.speed = n;
  if (key == "blend_weight") out.playback.blend_weight = n;
  return {};
}

bool any(const runtime::ObjectPlayback& p) {
  return p.clip_time_s || p.speed || p.blend_weight;
}

}  // namespace

Result<ObjectChange> read_object_change(std::string_view text) {
  const json body = json::parse(text, nullptr, false);
  if (!body.is_object()) return fail(ErrorCode::kInvalid, "the body", "is no JSON object");
  ObjectChange out;
  for (const auto& [key, value] : body.items()) PENUMBRA_TRY(read_key(key, value, out));
  return out;
}

void SceneControl::attach(Pipeline* pipeline) {
  const std::scoped_lock lock(mutex_);
  pipeline_ = pipeline;
  objects_.clear();
  if (!pipeline) return;
  for (const runtime::PreparedObject& o : pipeline->scene().objects)
    objects_[o.name] = {{o.world_from_bake.translation, 0},
                        o.world_from_bake.translation,
                        o.visible,
                        o.animation != nullptr || o.spin_rpm != 0};
}

Result<void> SceneControl::change(std::string_view object, const ObjectChange& change) {
  const std::scoped_lock lock(mutex_);
  if (!pipeline_) return fail(ErrorCode::kUnavailable, "the scene", "is still being prepared");
  const auto found = objects_.find(std::string(object));
  runtime::ObjectPlace place =
      found == objects_.end() ? runtime::ObjectPlace{} : found->second.place;
  if (change.position_m) place.position_m = *change.position_m;
  if (change.shift_m && found != objects_.end())
    place.position_m = found->second.at_first + *change.shift_m;
  if (change.turn_deg) place.turn_rad = *change.turn_deg * kDegree;
  const bool moves =
      change.position_m || change.shift_m || change.turn_deg || found == objects_.end();
  if (moves) PENUMBRA_TRY(pipeline_->move_object(object, place));
  if (any(change.playback))
    if (const auto played = pipeline_->play_object(object, change.playback); !played) {
      if (moves) PENUMBRA_TRY(pipeline_->move_object(object, found->second.place));
      return played;
    }
  if (change.visible) PENUMBRA_TRY(pipeline_->show_object(object, *change.visible));
  found->second.place = place;
  found->second.visible = change.visible.value_or(found->second.visible);
  return {};
}

json SceneControl::objects() const {
  const std::scoped_lock lock(mutex_);
  if (!pipeline_) return nullptr;
  json out = json::array();
  for (const auto& [name, o] : objects_) {
    const glm::dvec3& p = o.place.position_m;
    out.push_back({{"name", name},
                   {"position_m", {p.x, p.y, p.z}},
                   {"turn_deg", o.place.turn_rad / kDegree},
                   {"visible", o.visible},
                   {"plays", o.plays}});
  }
  return out;
}

}  // namespace penumbra::service
