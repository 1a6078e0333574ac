#include "service/scene_reload.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "core/io/log.h"

namespace penumbra::service {

namespace {

using runtime::SceneObject;

// The turn about the vertical from one to the other; nothing where one leans otherwise.
std::optional<double> turn_deg(const glm::dquat& from, const glm::dquat& to) {
  constexpr double kSame = 1e-6;
  const glm::dquat turn = glm::normalize(to * glm::conjugate(from));
  if (std::abs(turn.x) > kSame || std::abs(turn.z) > kSame) return std::nullopt;
  return 2 * std::atan2(turn.y, turn.w) * 180 / std::numbers::pi;
}

bool is_another_bake(const SceneObject& a, const SceneObject& b) {
  return a.asset != b.asset || a.animation != b.animation || a.transfer != b.transfer ||
         a.blend != b.blend || a.live != b.live || !(a.albedo == b.albedo) || a.scale != b.scale ||
         a.place_on_floor != b.place_on_floor || a.fit_size_m != b.fit_size_m ||
         a.spin_rpm != b.spin_rpm || a.light_map != b.light_map;
}

const SceneObject* find(const runtime::Scene& scene, const std::string& name) {
  const auto found = std::ranges::find(scene.objects, name, &SceneObject::name);
  return found == scene.objects.end() ? nullptr : &*found;
}

bool places_alike(const SceneObject& a, const SceneObject& b) {
  return a.position == b.position && a.rotation == b.rotation;
}

void apply(const SceneObject& at_first, const SceneObject* last, const SceneObject& now,
           SceneControl& objects) {
  ObjectChange change;
  const auto turn = turn_deg(at_first.rotation, now.rotation);
  if (!last || !places_alike(*last, now)) {
    change.shift_m = now.position - at_first.position;
    change.turn_deg = turn;
  }
  if (!last || last->visible != now.visible) change.visible = now.visible;
  if (!turn || is_another_bake(at_first, now))
    log_warning("{}: a change of more than place, turn and visibility takes a restart", now.name);
  if (const auto done = objects.change(now.name, change); !done)
    log_warning("{}: stays where it is: {} {}", now.name, done.error().where, done.error().detail);
}

}  // namespace

void apply_scene(const runtime::Scene& at_first, const runtime::Scene& last,
                 const runtime::Scene& now, SceneControl& objects) {
  for (const SceneObject& o : now.objects) {
    if (const SceneObject* const was = find(at_first, o.name))
      apply(*was, find(last, o.name), o, objects);
    else
      log_warning("{}: an object that is new takes a restart", o.name);
  }
  for (const SceneObject& o : at_first.objects) {
    if (find(now, o.name) || !find(last, o.name)) continue;
    (void)objects.change(o.name, {.visible = false});  // it was there: nothing can fail
    log_info("{}: is out of the scene file and hidden", o.name);
  }
}

}  // namespace penumbra::service
