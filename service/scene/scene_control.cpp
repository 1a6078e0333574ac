#include "service/scene/scene_control.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <iterator>
#include <numbers>
#include <span>
#include <utility>
#include <vector>

#include "core/io/spelling.h"
#include "runtime/pipeline/report.h"

namespace penumbra::service {

namespace {

using nlohmann::json;
namespace fs = std::filesystem;

constexpr double kDegree = std::numbers::pi / 180;
constexpr std::string_view kChangeKeys[] = {
    "position_m", "turn_deg",    "lean_deg", "lean_towards_deg",
    "visible",    "clip_time_s", "speed",    "blend_weight"};

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

// A key that is none of those known.
std::unexpected<Error> unknown(const std::string& key, std::span<const std::string_view> known) {
  const auto near = nearest_word(key, known);
  return fail(ErrorCode::kInvalid, key,
              near ? fmt::format("is no key here: did you mean {}?", *near) : "is no key here");
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
  if (std::ranges::find(kChangeKeys, key) == std::end(kChangeKeys))
    return unknown(key, kChangeKeys);
  PENUMBRA_ASSIGN(n, number(value, key));
  if (key == "turn_deg") out.turn_deg = n;
  if (key == "lean_deg") out.lean_deg = n;
  if (key == "lean_towards_deg") out.lean_towards_deg = n;
  if (key == "clip_time_s") out.playback.clip_time_s = n;
  if (key == "speed") out.playback.speed = n;
  if (key == "blend_weight") out.playback.blend_weight = n;
  return {};
}

constexpr std::string_view kNewKeys[] = {"name",     "asset",     "position_m",
                                         "turn_deg", "size_m",    "spin_rpm",
                                         "albedo",   "animation", "emission_lights"};

Result<std::string> text(const json& value, const std::string& key) {
  constexpr std::size_t kLongest = 63;  // as the light's page has room for
  if (!value.is_string()) return fail(ErrorCode::kInvalid, key, "is not a text");
  const auto& out = value.get_ref<const std::string&>();
  if (out.empty() || out.size() > kLongest)
    return fail(ErrorCode::kInvalid, key, "is empty or longer than 63 bytes");
  if (std::ranges::any_of(out, [](unsigned char c) { return c < 0x20 || c == 0x7f; }))
    return fail(ErrorCode::kInvalid, key, "holds control characters");
  return out;
}

Result<double> within(const json& value, const std::string& key, double low, double high) {
  PENUMBRA_ASSIGN(n, number(value, key));
  if (n < low || n > high)
    return fail(ErrorCode::kInvalid, key, fmt::format("is not within {}..{}", low, high));
  return n;
}

Result<void> read_key(const std::string& key, const json& value, runtime::SceneObject& out) {
  if (key == "name" || key == "asset" || key == "animation") {
    PENUMBRA_ASSIGN(word, text(value, key));
    (key == "name" ? out.name : key == "asset" ? out.asset : out.animation) = word;
  } else if (key == "position_m") {
    PENUMBRA_ASSIGN(p, position(value, key));
    out.position = p;
  } else if (key == "albedo") {
    PENUMBRA_ASSIGN(p, position(value, key));
    if (std::min({p.x, p.y, p.z}) < 0 || std::max({p.x, p.y, p.z}) > 1)
      return fail(ErrorCode::kInvalid, key, "is not within 0..1");
    out.albedo = {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)};
  } else if (key == "turn_deg") {
    PENUMBRA_ASSIGN(n, number(value, key));
    out.rotation = glm::angleAxis(n * kDegree, glm::dvec3(0, 1, 0));
  } else if (key == "size_m") {
    PENUMBRA_ASSIGN(n, within(value, key, .005, 100));
    out.fit_size_m = n;
  } else if (key == "spin_rpm") {
    PENUMBRA_ASSIGN(n, within(value, key, -600, 600));
    out.spin_rpm = n;
  } else if (key == "emission_lights") {
    if (!value.is_boolean()) return fail(ErrorCode::kInvalid, key, "is neither true nor false");
    out.emission_lights = value.get<bool>();
  } else {
    return unknown(key, kNewKeys);
  }
  return {};
}

// Never a path out of the folder, nor an address.
Result<std::string> asset_file(const std::string& asset, const fs::path& assets) {
  if (asset.starts_with("builtin:")) {
    if (std::ranges::find(runtime::kBuiltinAssets, asset) != runtime::kBuiltinAssets.end())
      return asset;
    return fail(ErrorCode::kNotFound, "asset",
                fmt::format("{} is none of {}", asset, fmt::join(runtime::kBuiltinAssets, ", ")));
  }
  std::error_code error;
  const fs::path folder = fs::canonical(assets, error);
  const auto outside = [&] {
    return fail(ErrorCode::kInvalid, "asset",
                "is neither built in nor a file in the folder of the scene");
  };
  if (error || assets.empty() || fs::path(asset).is_absolute()) return outside();
  const fs::path file = fs::weakly_canonical(folder / asset, error);
  if (error) return outside();
  const auto inside = std::mismatch(folder.begin(), folder.end(), file.begin(), file.end());
  if (inside.first != folder.end()) return outside();
  if (!fs::is_regular_file(file, error))
    return fail(ErrorCode::kNotFound, "asset", fmt::format("{} is not there", asset));
  return file.string();
}

bool any(const runtime::ObjectPlayback& p) {
  return p.clip_time_s || p.speed || p.blend_weight;
}

std::unexpected<Error> starting() {
  return fail(ErrorCode::kUnavailable, "the service", "is still starting");
}

std::unexpected<Error> no_lamp(std::size_t lamp) {
  return fail(ErrorCode::kNotFound, fmt::format("lamp {}", lamp), "is not in the scene");
}

const runtime::SceneObject* named(const runtime::Scene& scene, const std::string& name) {
  const auto found = std::ranges::find(scene.objects, name, &runtime::SceneObject::name);
  return found == scene.objects.end() ? nullptr : &*found;
}

constexpr double kFarthest_m = 1e4;  // beyond it floats have no room for a shadow

// The place moved along the normal of the floor that is nearest; as it is where there is none.
glm::dvec3 on_nearest_floor(const runtime::Scene& scene, const glm::dvec3& position) {
  constexpr double kLevel = .5;  // cosine: walls carry nothing
  std::optional<glm::dvec3> nearest;
  for (const runtime::RealGeometry& real : scene.real) {
    if (!real.plane) continue;
    const glm::dvec3 normal = glm::normalize(real.plane->normal);
    if (normal.y < kLevel) continue;
    const glm::dvec3 foot = position - glm::dot(position - real.plane->point, normal) * normal;
    if (!nearest || glm::distance(foot, position) < glm::distance(*nearest, position))
      nearest = foot;
  }
  return nearest.value_or(position);
}

json to_json(const glm::dvec3& v) {
  return {v.x, v.y, v.z};
}

}  // namespace

Result<ObjectChange> read_object_change(std::string_view text) {
  const json body = json::parse(text, nullptr, false);
  if (!body.is_object()) return fail(ErrorCode::kInvalid, "the body", "is no JSON object");
  ObjectChange out;
  for (const auto& [key, value] : body.items()) PENUMBRA_TRY(read_key(key, value, out));
  return out;
}

Result<runtime::SceneObject> read_new_object(std::string_view text, const fs::path& assets) {
  const json body = json::parse(text, nullptr, false);
  if (!body.is_object()) return fail(ErrorCode::kInvalid, "the body", "is no JSON object");
  runtime::SceneObject out;
  out.place_on_floor = true;
  for (const auto& [key, value] : body.items()) PENUMBRA_TRY(read_key(key, value, out));
  if (out.name.empty()) return fail(ErrorCode::kInvalid, "name", "is missing");
  if (out.asset.empty()) return fail(ErrorCode::kInvalid, "asset", "is missing");
  PENUMBRA_ASSIGN(file, asset_file(out.asset, assets));
  out.asset = file;
  return out;
}

namespace {

constexpr std::string_view kLampKeys[] = {"position_m", "radius_m", "irradiance_at_1m"};

}  // namespace

Result<shadows::Lamp> read_lamp_change(std::string_view text, const shadows::Lamp& before) {
  const json body = json::parse(text, nullptr, false);
  if (!body.is_object()) return fail(ErrorCode::kInvalid, "the body", "is no JSON object");
  shadows::Lamp out = before;
  for (const auto& [key, value] : body.items()) {
    if (key == "position_m") {
      PENUMBRA_ASSIGN(p, position(value, key));
      out.position = p;
    } else if (key == "radius_m") {
      PENUMBRA_ASSIGN(n, within(value, key, .001, 10));
      out.radius_m = n;
    } else if (key == "irradiance_at_1m") {
      PENUMBRA_ASSIGN(p, position(value, key));
      if (std::min({p.x, p.y, p.z}) < 0) return fail(ErrorCode::kInvalid, key, "is below 0");
      out.irradiance_at_1m = {static_cast<float>(p.x), static_cast<float>(p.y),
                              static_cast<float>(p.z)};
    } else {
      return unknown(key, kLampKeys);
    }
  }
  return out;
}

bool is_another_bake(const runtime::SceneObject& a, const runtime::SceneObject& b) {
  return a.asset != b.asset || a.animation != b.animation || a.transfer != b.transfer ||
         a.blend != b.blend || a.live != b.live || !(a.albedo == b.albedo) || a.scale != b.scale ||
         a.place_on_floor != b.place_on_floor || a.fit_size_m != b.fit_size_m ||
         a.spin_rpm != b.spin_rpm || a.max_vertices != b.max_vertices ||
         a.light_map != b.light_map || a.emission_lights != b.emission_lights;
}

bool have_same_lamps(const runtime::Scene& a, const runtime::Scene& b) {
  return std::ranges::equal(a.lamps, b.lamps, [](const auto& x, const auto& y) {
    return x.position == y.position && x.radius_m == y.radius_m &&
           x.irradiance_at_1m == y.irradiance_at_1m;
  });
}

Result<fs::path> scene_file_in(const fs::path& folder, std::string_view name) {
  const fs::path file(name);
  const bool is_text = name.find('\0') == std::string_view::npos;
  if (!is_text || folder.empty() || file.filename() != file || file.extension() != ".toml")
    return fail(ErrorCode::kInvalid, "file", "is no .toml file in the folder of the scene");
  return folder / file;
}

void SceneControl::attach(Pipeline* pipeline, SceneKeeper* keeper) {
  const std::scoped_lock lock(mutex_);
  pipeline_ = pipeline;
  keeper_ = keeper;
}

void SceneControl::set_scene(const runtime::Scene& scene, const fs::path& file) {
  const std::scoped_lock lock(mutex_);
  scene_ = scene;
  file_ = {file, scene};
}

std::optional<runtime::ObjectState> SceneControl::find(std::string_view object) const {
  if (!pipeline_) return std::nullopt;
  std::vector<runtime::ObjectState> all = pipeline_->objects();
  const auto found = std::ranges::find(all, object, &runtime::ObjectState::name);
  return found == all.end() ? std::nullopt : std::optional(std::move(*found));
}

std::optional<runtime::ObjectState> SceneControl::state_of(std::string_view object) const {
  const std::scoped_lock lock(mutex_);
  return find(object);
}

Result<void> SceneControl::change(std::string_view object, const ObjectChange& change) {
  const std::scoped_lock lock(mutex_);
  if (!pipeline_) return starting();
  const auto before = find(object);
  runtime::ObjectPlace place = before ? before->place : runtime::ObjectPlace{};
  if (change.position_m) place.position_m = *change.position_m;
  if (change.shift_m && before) {
    constexpr double kSame_m = 1e-6;
    if (before->on_plane && std::abs(glm::dot(*change.shift_m, before->normal)) > kSame_m)
      return fail(ErrorCode::kInvalid, fmt::format("object \"{}\"", object),
                  "is shifted off its plane");
    place.position_m = before->rest_position_m + *change.shift_m;
  }
  if (change.turn_deg) place.turn_rad = *change.turn_deg * kDegree;
  if (change.lean_deg) place.lean_rad = *change.lean_deg * kDegree;
  if (change.lean_towards_deg) place.lean_towards_rad = *change.lean_towards_deg * kDegree;
  const bool moves = change.position_m || change.shift_m || change.turn_deg || change.lean_deg ||
                     change.lean_towards_deg || !before;
  if (moves) PENUMBRA_TRY(pipeline_->move_object(object, place));
  if (any(change.playback))
    if (const auto played = pipeline_->play_object(object, change.playback); !played) {
      if (moves) PENUMBRA_TRY(pipeline_->move_object(object, before->place));
      return played;
    }
  return change.visible ? pipeline_->show_object(object, *change.visible) : Result<void>{};
}

Result<void> SceneControl::add(const runtime::SceneObject& object) {
  const std::scoped_lock lock(mutex_);
  if (!keeper_) return starting();
  if (named(scene_, object.name))
    return fail(ErrorCode::kInvalid, fmt::format("object \"{}\"", object.name),
                "is in the scene already");
  if (glm::length(object.position) > kFarthest_m)
    return fail(ErrorCode::kInvalid, "position_m", "is farther away than 10000 m");
  if (scene_.objects.size() >= kMaxObjects)
    return fail(ErrorCode::kInvalid, "the scene",
                fmt::format("has {} objects, and more are not taken", kMaxObjects));
  scene_.objects.push_back(object);
  scene_.objects.back().position = on_nearest_floor(scene_, object.position);
  scene_.objects.back().instance = ++instances_;
  added_.insert(object.name);
  keeper_->want(scene_);
  return {};
}

Result<void> SceneControl::add_lamp(std::string_view text) {
  const std::scoped_lock lock(mutex_);
  if (!keeper_) return starting();
  if (scene_.lamps.size() >= kMaxLamps)
    return fail(ErrorCode::kInvalid, "the scene",
                fmt::format("has {} lamps, and more are not taken", kMaxLamps));
  PENUMBRA_ASSIGN(lamp, read_lamp_change(text, {}));
  scene_.lamps.push_back(lamp);
  keeper_->want(scene_);
  return {};
}

Result<void> SceneControl::change_lamp(std::size_t lamp, std::string_view text) {
  const std::scoped_lock lock(mutex_);
  if (!keeper_) return starting();
  if (lamp >= scene_.lamps.size()) return no_lamp(lamp);
  PENUMBRA_ASSIGN(changed, read_lamp_change(text, scene_.lamps[lamp]));
  scene_.lamps[lamp] = changed;
  keeper_->want(scene_);
  return {};
}

Result<void> SceneControl::remove_lamp(std::size_t lamp) {
  const std::scoped_lock lock(mutex_);
  if (!keeper_) return starting();
  if (lamp >= scene_.lamps.size()) return no_lamp(lamp);
  scene_.lamps.erase(scene_.lamps.begin() + static_cast<std::ptrdiff_t>(lamp));
  keeper_->want(scene_);
  return {};
}

Result<void> SceneControl::show_scene(const runtime::Scene& scene, const fs::path& file) {
  const std::scoped_lock lock(mutex_);
  if (!keeper_) return starting();
  scene_ = scene;
  for (runtime::SceneObject& o : scene_.objects) o.instance = ++instances_;
  added_.clear(), taken_away_.clear();
  file_ = {file, scene};
  keeper_->forget_faults();
  keeper_->want(scene_);
  return {};
}

void SceneControl::follow_file(const SceneFile& last, const runtime::Scene& now, bool bakes) {
  const std::scoped_lock lock(mutex_);
  if (file_.path != last.path) return;
  file_.scene = now;
  runtime::Scene wanted = now;
  std::erase_if(wanted.objects, [&](const auto& o) {
    return taken_away_.contains(o.name) || added_.contains(o.name);
  });
  for (runtime::SceneObject& o : wanted.objects) {
    const runtime::SceneObject* const before = named(last.scene, o.name);
    const runtime::SceneObject* const mine = named(scene_, o.name);
    const bool is_another = !before || !mine || is_another_bake(*before, o);
    o.instance = is_another ? ++instances_ : mine->instance;
  }
  for (const runtime::SceneObject& o : scene_.objects)
    if (added_.contains(o.name)) wanted.objects.push_back(o);
  if (have_same_lamps(last.scene, now)) wanted.lamps = scene_.lamps;
  scene_ = wanted;
  if (!keeper_ || !bakes) return;
  keeper_->forget_faults();
  keeper_->want(std::move(wanted));
}

Result<void> SceneControl::remove(const std::string& object) {
  const std::scoped_lock lock(mutex_);
  if (!keeper_) return starting();
  const bool shown = find(object).has_value(), was_told = keeper_->forget_fault(object);
  if (shown) PENUMBRA_TRY(pipeline_->show_object(object, false));
  if (std::erase_if(scene_.objects, [&](const auto& o) { return o.name == object; }) > 0) {
    if (added_.erase(object) == 0) taken_away_.insert(object);
    keeper_->want(scene_);
  } else if (!shown && !was_told) {
    return fail(ErrorCode::kNotFound, fmt::format("object \"{}\"", object), "is not in the scene");
  }
  return {};
}

void SceneControl::forget(const std::string& object) {
  const std::scoped_lock lock(mutex_);
  std::erase_if(scene_.objects, [&](const auto& o) { return o.name == object; });
  added_.erase(object);
}

SceneFile SceneControl::file() const {
  const std::scoped_lock lock(mutex_);
  return file_;
}

Result<void> SceneControl::set_max_shadow_error(double error) {
  const std::scoped_lock lock(mutex_);
  if (!pipeline_) return starting();
  return pipeline_->set_max_shadow_error(error);
}

std::optional<double> SceneControl::max_shadow_error() const {
  const std::scoped_lock lock(mutex_);
  return pipeline_ ? std::optional(pipeline_->max_shadow_error()) : std::nullopt;
}

json SceneControl::objects() const {
  const std::scoped_lock lock(mutex_);
  if (!pipeline_) return nullptr;
  json out = json::array();
  for (const runtime::ObjectState& o : pipeline_->objects())
    out.push_back({{"name", o.name},
                   {"position_m", to_json(o.place.position_m)},
                   {"turn_deg", o.place.turn_rad / kDegree},
                   {"lean_deg", o.place.lean_rad / kDegree},
                   {"lean_towards_deg", o.place.lean_towards_rad / kDegree},
                   {"forward", to_json(o.forward)},
                   {"height_m", o.height_m},
                   {"lifts", o.lifts},
                   {"visible", o.visible},
                   {"plays", o.plays},
                   {"speed", o.speed},
                   {"normal", to_json(o.normal)},
                   {"centre_m", to_json(o.centre_m)},
                   {"radius_m", o.radius_m}});
  return out;
}

std::vector<std::string> SceneControl::awaited() const {
  const std::scoped_lock lock(mutex_);
  std::vector<std::string> out;
  if (!pipeline_ || !keeper_) return out;
  const auto shown = pipeline_->objects();
  const auto faults = keeper_->faults();
  for (const runtime::SceneObject& o : scene_.objects)
    if (!faults.contains(o.name) &&
        std::ranges::find(shown, o.name, &runtime::ObjectState::name) == shown.end())
      out.push_back(o.name);
  return out;
}

json SceneControl::surroundings() const {
  const std::scoped_lock lock(mutex_);
  json planes = json::array(), lamps = json::array();
  for (const runtime::RealGeometry& real : scene_.real)
    if (real.plane)
      planes.push_back(
          {{"point_m", to_json(real.plane->point)}, {"normal", to_json(real.plane->normal)}});
  for (const shadows::Lamp& lamp : scene_.lamps)
    lamps.push_back({{"position_m", to_json(glm::dvec3(lamp.position))},
                     {"radius_m", lamp.radius_m},
                     {"irradiance_at_1m", runtime::to_json(lamp.irradiance_at_1m)}});
  return {{"planes", planes}, {"lamps", lamps}};
}

json SceneControl::faults() const {
  const std::scoped_lock lock(mutex_);
  json out = json::object();
  if (keeper_)
    for (const auto& [object, reason] : keeper_->faults()) out[object] = reason;
  return out;
}

}  // namespace penumbra::service
