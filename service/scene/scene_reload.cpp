#include "service/scene/scene_reload.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <utility>

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

const SceneObject* find(const runtime::Scene& scene, const std::string& name) {
  const auto found = std::ranges::find(scene.objects, name, &SceneObject::name);
  return found == scene.objects.end() ? nullptr : &*found;
}

bool places_alike(const SceneObject& a, const SceneObject& b) {
  return a.position == b.position && a.rotation == b.rotation;
}

// True where it has to be baked anew.
bool apply(const SceneObject& shown, const SceneObject* last, const SceneObject& now,
           SceneControl& objects) {
  ObjectChange change;
  const auto turn = turn_deg(shown.rotation, now.rotation);
  if (!last || !places_alike(*last, now)) {
    change.shift_m = now.position - shown.position;
    change.turn_deg = turn;
  }
  if (!last || last->visible != now.visible) change.visible = now.visible;
  if (!turn || is_another_bake(shown, now)) return true;
  const auto done = objects.change(now.name, change);
  if (done) return false;
  // On another plane it is another object.
  log_info("{}: {} {}: it is loaded anew", now.name, done.error().where, done.error().detail);
  return true;
}

bool are_alike(const runtime::RealGeometry& a, const runtime::RealGeometry& b) {
  const auto plane = [](const runtime::RealGeometry& g) {
    return g.plane ? std::pair(g.plane->point, g.plane->normal)
                   : std::pair(glm::dvec3(0), glm::dvec3(0));
  };
  return a.plane.has_value() == b.plane.has_value() && plane(a) == plane(b) && a.mesh == b.mesh &&
         a.depth == b.depth && a.camera == b.camera && a.albedo == b.albedo &&
         a.position == b.position && a.rotation == b.rotation && a.scale == b.scale;
}

}  // namespace

bool apply_scene(const runtime::Scene& shown, const runtime::Scene& last, const runtime::Scene& now,
                 SceneControl& objects) {
  bool more = !std::ranges::equal(last.real, now.real, are_alike) || !have_same_lamps(last, now);
  for (const SceneObject& o : now.objects) {
    const SceneObject* const was = find(shown, o.name);
    more |= !was || apply(*was, find(last, o.name), o, objects);
  }
  for (const SceneObject& o : shown.objects) {
    if (find(now, o.name) || !find(last, o.name)) continue;
    (void)objects.change(o.name, {.visible = false});  // it was there: nothing can fail
    log_info("{}: is out of the scene file", o.name);
    more = true;
  }
  // What is still being baked must not come either.
  more |= std::ranges::any_of(last.objects, [&](const SceneObject& o) {
    return !find(now, o.name) && !find(shown, o.name);
  });
  return more;
}

}  // namespace penumbra::service
