#include "runtime/shading/object_moves.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <glm/geometric.hpp>
#include <map>
#include <utility>

#include "core/conventions.h"
#include "core/io/files.h"
#include "core/io/spelling.h"
#include "prt/geometry/mesh.h"

namespace penumbra::runtime {

namespace {

constexpr std::string_view kHeader = "time_s,object,x_m,y_m,z_m,turn_deg",
                           kLeaningHeader =
                               "time_s,object,x_m,y_m,z_m,turn_deg,lean_deg,lean_towards_deg";
constexpr std::size_t kColumns = 6, kLeaningColumns = 8;
constexpr double kLifted_m = .01;       // nearer to its plane an object is lit as it stands on it
constexpr double kLifted = .04;         // or so much of its radius
constexpr double kLeans_rad = 1e-3;     // what leans by less stands upright
constexpr double kFarthest_m = 10'000;  // as in a scene's file
constexpr double kMaxTurns = 10'000;    // of any angle: beyond, degrees get lost

// Signed distance of a place from the plane that a pose stands on.
double off_plane(const Pose& standing, const glm::dvec3& position) {
  return glm::dot(position - standing.translation, standing.rotation * glm::dvec3(0, 1, 0));
}

glm::dvec2 lean_of(const ObjectPlace& p) {
  return p.lean_rad * glm::dvec2(std::sin(p.lean_towards_rad), std::cos(p.lean_towards_rad));
}

ObjectPlace between(const ObjectPlace& a, const ObjectPlace& b, double fraction) {
  const glm::dvec2 lean = glm::mix(lean_of(a), lean_of(b), fraction);
  return {a.position_m + fraction * (b.position_m - a.position_m),
          std::lerp(a.turn_rad, b.turn_rad, fraction), glm::length(lean),
          std::atan2(lean.x, lean.y)};
}

// Turns what is upright so that its top goes the way of the lean.
glm::dquat turn_of_lean(const ObjectPlace& p) {
  return glm::angleAxis(p.lean_rad,
                        glm::dvec3(std::cos(p.lean_towards_rad), 0, -std::sin(p.lean_towards_rad)));
}

bool leans(const ObjectPlace& p) {
  return std::abs(std::remainder(p.lean_rad, 2 * kPi)) > kLeans_rad;
}

std::string_view without_edges(std::string_view text) {
  const auto first = text.find_first_not_of(" \t\r"), last = text.find_last_not_of(" \t\r");
  return first == std::string_view::npos ? "" : text.substr(first, last - first + 1);
}

// Nothing where there are not as many as columns.
std::optional<std::array<std::string_view, kLeaningColumns>> split(std::string_view line,
                                                                   std::size_t columns) {
  std::array<std::string_view, kLeaningColumns> out;
  for (std::size_t i = 0; i < columns; ++i) {
    const auto comma = line.find(',');
    if ((comma == std::string_view::npos) != (i + 1 == columns)) return std::nullopt;
    out[i] = without_edges(line.substr(0, comma));
    line.remove_prefix(
        std::min(line.size(), comma == std::string_view::npos ? line.size() : comma + 1));
  }
  return out;
}

std::optional<double> number(std::string_view text) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  const bool whole = error == std::errc() && end == text.data() + text.size();
  return whole && std::isfinite(value) ? std::optional(value) : std::nullopt;
}

}  // namespace

Result<ObjectTrack> read_object_track(const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(whole, read_text(path));
  std::string_view text = whole;
  ObjectTrack out;
  std::map<std::string, double, std::less<>> last;
  std::size_t width = kColumns;
  for (int line = 1; !text.empty(); ++line) {
    const auto end = std::min(text.find('\n'), text.size());
    const std::string_view row = without_edges(text.substr(0, end));
    text.remove_prefix(std::min(text.size(), end + 1));
    const auto invalid = [&](const std::string& detail) {
      return fail(ErrorCode::kInvalid, fmt::format("{}:{}", path.string(), line), detail);
    };
    if (line == 1) {
      if (row == kLeaningHeader)
        width = kLeaningColumns;
      else if (row != kHeader)
        return invalid(fmt::format("begins neither with {} nor with {}", kHeader, kLeaningHeader));
      continue;
    }
    if (row.empty()) continue;
    const auto columns = split(row, width);
    if (!columns) return invalid(fmt::format("does not have {} columns", width));
    std::array<double, kLeaningColumns> values{};
    for (std::size_t i = 0; i < width; ++i) {
      if (i == 1) continue;  // the name
      const auto value = number((*columns)[i]);
      if (!value) return invalid(fmt::format("\"{}\" is not a number", (*columns)[i]));
      values[i] = *value;
    }
    const std::string object((*columns)[1]);
    const auto before = last.find(object);
    if (before != last.end() && values[0] <= before->second)
      return invalid(fmt::format("\"{}\" has a time that is not after the one before", object));
    last[object] = values[0];
    out.keys.push_back({values[0],
                        object,
                        {{values[2], values[3], values[4]},
                         values[5] * kPi / 180,
                         values[6] * kPi / 180,
                         values[7] * kPi / 180}});
  }
  if (out.keys.empty()) return fail(ErrorCode::kInvalid, path.string(), "has no places");
  return out;
}

ObjectMoves::ObjectMoves(const PreparedScene& scene)
    : scene_(scene), places_(scene.objects.size()), playing_(scene.objects.size()) {
  for (const PreparedObject& o : scene.objects) {
    const prt::Bounds b = prt::bounds_of(o.baked.mesh);
    resting_.push_back({o.name, o.instance, o.world_from_bake, o.baked.receiver.has_value(),
                        o.animation || o.spin_rpm != 0, o.animation && o.animation->blend,
                        o.animation != nullptr, glm::dvec3(b.centre()),
                        double(glm::length(b.high - b.low)) / 2});
  }
  for (const PreparedObject& o : scene.objects) visible_.push_back(o.visible);
}

Result<std::size_t> ObjectMoves::index_of(std::string_view object) const {
  const auto found = std::ranges::find(resting_, object, &Resting::name);
  if (found != resting_.end()) return static_cast<std::size_t>(found - resting_.begin());
  std::vector<std::string_view> names;
  for (const Resting& o : resting_) names.push_back(o.name);
  const auto near = nearest_word(object, names);
  return fail(ErrorCode::kNotFound, fmt::format("object \"{}\"", object),
              near ? fmt::format("is not in the scene: did you mean \"{}\"?", *near)
                   : fmt::format("is not in the scene, which has {}", fmt::join(names, ", ")));
}

Result<void> ObjectMoves::check(std::size_t object, const ObjectPlace& place) const {
  const Resting& o = resting_[object];
  const std::string where = fmt::format("object \"{}\"", o.name);
  const glm::dvec3& p = place.position_m;
  if (!std::isfinite(p.x + p.y + p.z + place.turn_rad + place.lean_rad + place.lean_towards_rad))
    return fail(ErrorCode::kNonFinite, where, "is put at a place that is not finite");
  if (std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}) > kFarthest_m)
    return fail(ErrorCode::kInvalid, where,
                fmt::format("is put farther than {:.0f} m from the origin", kFarthest_m));
  if (std::max({std::abs(place.turn_rad), std::abs(place.lean_rad),
                std::abs(place.lean_towards_rad)}) > 2 * kPi * kMaxTurns)
    return fail(ErrorCode::kInvalid, where,
                fmt::format("is turned by more than {:.0f} times 360 degrees", kMaxTurns));
  const double off = o.on_plane ? off_plane(o.world_from_bake, p) : 0;
  if (off < -kLifted_m)
    return fail(ErrorCode::kInvalid, where,
                fmt::format("is put {:.3f} m below the plane that it belongs to", -off));
  if (o.has_clip && (off > kLifted_m || leans(place)))
    return fail(ErrorCode::kInvalid, where,
                "plays a clip, which is baked on its plane and upright: it cannot be lifted and "
                "does not lean");
  return {};
}

// After a turntable's turn, in the frame in which it is baked: about its middle, at the height that
// it had. What stands on no plane keeps its middle where it is. A turntable's axis leans with it.
Pose ObjectMoves::leaning(std::size_t object, const ObjectPlace& place, const Pose& spun) const {
  const Resting& o = resting_[object];
  const glm::dquat lean = turn_of_lean(place);
  const glm::dvec3 middle = spun * o.centre_m;
  Pose out = Pose{lean, middle - lean * middle} * spun;
  if (!o.on_plane) return out;
  const prt::BakedObject& baked = scene_.objects[object].baked;
  const prt::Mesh& mesh = baked.fine ? baked.fine->mesh : baked.mesh;
  const glm::vec3 up(glm::conjugate(out.rotation) * glm::dvec3(0, 1, 0));
  float upright = HUGE_VALF, now = HUGE_VALF;
  for (const glm::vec3& p : mesh.positions) {
    upright = std::min(upright, p.y);
    now = std::min(now, glm::dot(p, up));
  }
  out.translation.y = double(upright) - double(now);
  return out;
}

ObjectMoves::ObjectPoses ObjectMoves::pose_at(std::size_t object, const ObjectPlace& place,
                                              double turntable_s) const {
  const Resting& o = resting_[object];
  const glm::dvec3 normal = o.world_from_bake.rotation * glm::dvec3(0, 1, 0);
  const Pose turn{glm::angleAxis(place.turn_rad, glm::dvec3(0, 1, 0)), {0, 0, 0}};
  // A turntable turns it about its own axis, as from the scene's pose.
  const Pose spun = o.world_from_bake.inverse() * scene_.objects[object].pose_at(turntable_s);
  const double above = o.on_plane ? off_plane(o.world_from_bake, place.position_m) : 0,
               off = std::max(0., above);
  const Pose upright = Pose{o.world_from_bake.rotation, place.position_m - above * normal} * turn;
  ObjectPoses out{upright * spun, upright * spun};
  if (leans(place)) out.world_from_bake = upright * leaning(object, place, spun);
  out.world_from_bake.translation += off * normal;
  out.lifted = o.on_plane && (leans(place) || off > std::min(kLifted_m, kLifted * o.radius_m));
  if (!o.on_plane) out.world_from_floor = out.world_from_bake;
  return out;
}

Result<void> ObjectMoves::put(std::string_view object, const ObjectPlace& place) {
  PENUMBRA_ASSIGN(index, index_of(object));
  PENUMBRA_TRY(check(index, place));
  const std::scoped_lock lock(mutex_);
  places_[index] = {{0, place}};
  return {};
}

Result<void> ObjectMoves::follow(const ObjectTrack& track) {
  std::vector<std::vector<TimedPlace>> places(scene_.objects.size());
  for (const ObjectTrack::TrackKey& key : track.keys) {
    const auto at = [&](const Error& e) {
      return fail(e.code, fmt::format("{} at {} s", e.where, key.time_s), e.detail);
    };
    const auto index = index_of(key.object);
    if (!index) return at(index.error());
    if (const auto good = check(*index, key.place); !good) return at(good.error());
    std::vector<TimedPlace>& of_object = places[*index];
    if (!(std::isfinite(key.time_s) && (of_object.empty() || key.time_s > of_object.back().time_s)))
      return at({ErrorCode::kInvalid, fmt::format("object \"{}\"", key.object),
                 "has a time that is not after the one before"});
    of_object.push_back({key.time_s, key.place});
  }
  const std::scoped_lock lock(mutex_);
  for (std::size_t i = 0; i < places.size(); ++i)
    if (!places[i].empty()) places_[i] = std::move(places[i]);
  return {};
}

Result<void> ObjectMoves::show(std::string_view object, bool visible) {
  PENUMBRA_ASSIGN(index, index_of(object));
  const std::scoped_lock lock(mutex_);
  visible_[index] = visible;
  return {};
}

Result<void> ObjectMoves::play(std::string_view object, const ObjectPlayback& playback) {
  PENUMBRA_ASSIGN(index, index_of(object));
  const Resting& o = resting_[index];
  const std::string where = fmt::format("object \"{}\"", o.name);
  const double weight = playback.blend_weight.value_or(0);
  if (!std::isfinite(playback.clip_time_s.value_or(0) + playback.speed.value_or(0) + weight))
    return fail(ErrorCode::kNonFinite, where, "is to play at a time or speed that is not finite");
  if (!o.plays) return fail(ErrorCode::kInvalid, where, "has neither a clip nor a turntable");
  if (playback.blend_weight && !o.blends)
    return fail(ErrorCode::kInvalid, where, "has no second clip to blend with");
  if (!(weight >= 0 && weight <= 1))
    return fail(ErrorCode::kInvalid, where,
                fmt::format("has a blend weight of {}, which is not within 0..1", weight));
  const std::scoped_lock lock(mutex_);
  ObjectPlayback& next =
      playing_[index].next ? *playing_[index].next : playing_[index].next.emplace();
  if (playback.clip_time_s) next.clip_time_s = playback.clip_time_s;
  if (playback.speed) next.speed = playback.speed;
  if (playback.blend_weight) next.blend_weight = playback.blend_weight;
  return {};
}

// In the lock.
const ObjectMoves::Playing& ObjectMoves::play_on(std::size_t object, double seconds) {
  Playing& now = playing_[object];
  if (!now.next) return now;
  const ObjectPlayback next = *std::exchange(now.next, std::nullopt);
  now.from_s = next.clip_time_s.value_or(now.clip_time_at(seconds));
  now.since_s = seconds;
  now.speed = next.speed.value_or(now.speed);
  if (next.blend_weight) now.blend_weight = static_cast<float>(*next.blend_weight);
  return now;
}

ObjectMoves::ObjectNow ObjectMoves::at(std::size_t object, double seconds) {
  constexpr double kOutOfTheWorld_m = 1e5;
  const std::scoped_lock lock(mutex_);
  now_s_ = seconds;
  const Playing& playing = play_on(object, seconds);
  const double clip_time_s = playing.clip_time_at(seconds);
  if (visible_[object]) {
    const ObjectPoses here = placed(object, seconds, clip_time_s);
    return {true,        here.world_from_bake, here.world_from_floor, here.lifted,
            clip_time_s, playing.speed,        playing.blend_weight};
  }
  // Always the same, so that it counts as at rest.
  const Pose& rest = resting_[object].world_from_bake;
  const Pose below{rest.rotation,
                   rest.translation - kOutOfTheWorld_m * (rest.rotation * glm::dvec3(0, 1, 0))};
  return {false, below, below, false, clip_time_s, playing.speed, playing.blend_weight};
}

// In the lock; in: it has places.
ObjectPlace ObjectMoves::place_at(std::size_t object, double seconds) const {
  const std::vector<TimedPlace>& places = places_[object];
  const auto next = std::ranges::upper_bound(places, seconds, {}, &TimedPlace::time_s);
  if (next == places.begin()) return next->place;
  const auto last = next - 1;
  if (next == places.end()) return last->place;
  const double fraction = (seconds - last->time_s) / (next->time_s - last->time_s);
  return between(last->place, next->place, fraction);
}

// In the lock.
ObjectMoves::ObjectPoses ObjectMoves::placed(std::size_t object, double seconds,
                                             double turntable_s) const {
  if (places_[object].empty()) {
    const Pose here = scene_.objects[object].pose_at(turntable_s);
    return {here, here};
  }
  return pose_at(object, place_at(object, seconds), turntable_s);
}

double ObjectMoves::now_s() const {
  const std::scoped_lock lock(mutex_);
  return now_s_;
}

bool ObjectMoves::is_lifted(std::size_t object) const {
  const std::scoped_lock lock(mutex_);
  return visible_[object] && placed(object, now_s_, playing_[object].clip_time_at(now_s_)).lifted;
}

std::vector<ObjectState> ObjectMoves::states() const {
  const std::scoped_lock lock(mutex_);
  std::vector<ObjectState> out;
  for (std::size_t i = 0; i < resting_.size(); ++i) {
    const Resting& o = resting_[i];
    ObjectState now;
    now.name = o.name;
    now.place =
        places_[i].empty() ? ObjectPlace{o.world_from_bake.translation, 0} : place_at(i, now_s_);
    now.visible = visible_[i] != 0;
    now.on_plane = o.on_plane;
    if (o.on_plane) now.height_m = std::max(0., off_plane(o.world_from_bake, now.place.position_m));
    now.lifts = !o.has_clip;
    now.plays = o.plays;
    now.speed = playing_[i].speed;
    if (playing_[i].next) now.speed = playing_[i].next->speed.value_or(now.speed);
    now.rest_position_m = o.world_from_bake.translation;
    now.normal = o.world_from_bake.rotation * glm::dvec3(0, 1, 0);
    const ObjectPoses here = placed(i, now_s_, playing_[i].clip_time_at(now_s_));
    now.world_from_bake = here.world_from_bake;
    now.forward = o.world_from_bake.rotation *
                  (glm::angleAxis(now.place.turn_rad, glm::dvec3(0, 1, 0)) * glm::dvec3(0, 0, 1));
    now.centre_m = now.world_from_bake * o.centre_m;
    now.radius_m = o.radius_m;
    out.push_back(std::move(now));
  }
  return out;
}

// The same pose in the world, as a place of an object that rests otherwise than before; nothing
// where that stands on another plane.
std::optional<ObjectPlace> ObjectMoves::carried(std::size_t object, const Resting& before,
                                                ObjectPlace place) const {
  constexpr double kSame = 1e-6;
  const Resting& o = resting_[object];
  const glm::dquat turn =
      glm::normalize(glm::conjugate(o.world_from_bake.rotation) * before.world_from_bake.rotation);
  if (std::abs(turn.x) > kSame || std::abs(turn.z) > kSame) return std::nullopt;
  const double height = off_plane(o.world_from_bake, place.position_m),
               was = off_plane(before.world_from_bake, place.position_m);
  if (o.on_plane && std::abs(height - was) > kSame) return std::nullopt;
  place.turn_rad += 2 * std::atan2(turn.y, turn.w);
  return check(object, place) ? std::optional(place) : std::nullopt;
}

void ObjectMoves::go_on_from(const ObjectMoves& before) {
  const std::scoped_lock lock(mutex_, before.mutex_);
  now_s_ = before.now_s_;
  for (std::size_t i = 0; i < resting_.size(); ++i) {
    const auto found = std::ranges::find(before.resting_, resting_[i].name, &Resting::name);
    if (found == before.resting_.end() || found->instance != resting_[i].instance) continue;
    const auto was = static_cast<std::size_t>(found - before.resting_.begin());
    visible_[i] = before.visible_[was];
    if (resting_[i].plays && found->plays) playing_[i] = before.playing_[was];
    std::vector<TimedPlace> places;
    for (const TimedPlace& p : before.places_[was])
      if (const auto place = carried(i, *found, p.place)) places.push_back({p.time_s, *place});
    if (places.size() == before.places_[was].size()) places_[i] = std::move(places);
  }
}

}  // namespace penumbra::runtime
