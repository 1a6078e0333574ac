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

void apply(const SceneObject& before, const SceneObject& now, SceneControl& objects) {
  ObjectChange change;
  change.position_m = now.position;
  change.turn_deg = turn_deg(before.rotation, now.rotation);
  change.visible = now.visible;
  if (!change.turn_deg || is_another_bake(before, now))
    log_warning("{}: a change of more than place, turn and visibility takes a restart", now.name);
  if (const auto done = objects.change(now.name, change); !done)
    log_warning("{}: stays where it is: {} {}", now.name, done.error().where, done.error().detail);
}

}  // namespace

void apply_scene(const runtime::Scene& before, const runtime::Scene& now, SceneControl& objects) {
  for (const SceneObject& o : now.objects) {
    const SceneObject* const was = find(before, o.name);
    if (was)
      apply(*was, o, objects);
    else
      log_warning("{}: an object that is new takes a restart", o.name);
  }
  for (const SceneObject& o : before.objects) {
    if (find(now, o.name)) continue;
    (void)objects.change(o.name, {.visible = false});  // it was there: nothing can fail
    log_info("{}: is out of the scene file and hidden", o.name);
  }
}

}  // namespace penumbra::service
