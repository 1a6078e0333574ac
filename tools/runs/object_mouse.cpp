#include "tools/runs/object_mouse.h"

#include <cmath>
#include <glm/geometric.hpp>
#include <utility>

#include "core/conventions.h"
#include "prt/geometry/mesh.h"

namespace penumbra::tools {

namespace {

constexpr double kWheelTurn_rad = 10 * kPi / 180;  // of a notch
constexpr double kFar_m = 30;                      // along a plane, where a pixel is metres wide

glm::dvec3 normal_of(const runtime::PreparedObject& o) {
  return o.world_from_bake.rotation * glm::dvec3(0, 1, 0);
}

// How far along a ray a sphere begins; nothing where the ray misses it.
std::optional<double> sphere_hit(const glm::dvec3& origin, const glm::dvec3& direction,
                                 const glm::dvec3& centre, double radius) {
  const glm::dvec3 to = centre - origin;
  const double along = glm::dot(to, direction),
               beside = glm::dot(to, to) - along * along - radius * radius;
  if (along <= 0 || beside > 0) return std::nullopt;
  return along - std::sqrt(-beside);
}

}  // namespace

ObjectMouse::ObjectMouse(const runtime::PreparedScene& scene, Move move, Show show, Play play)
    : scene_(scene), move_(std::move(move)), show_(std::move(show)), play_(std::move(play)) {
  for (const runtime::PreparedObject& o : scene.objects) {
    places_.push_back({o.world_from_bake.translation, 0});
    visible_.push_back(o.visible);
  }
}

std::optional<std::size_t> ObjectMouse::object_at(const Ray& ray) const {
  constexpr double kOfHalfDiagonal = .8;  // corners of a box are mostly empty
  std::optional<std::size_t> nearest;
  double distance = HUGE_VAL;
  for (std::size_t i = 0; i < places_.size(); ++i) {
    if (!visible_[i]) continue;
    const runtime::PreparedObject& o = scene_.objects[i];
    const prt::Bounds b = prt::bounds_of(o.baked.mesh);
    const Pose pose = Pose{o.world_from_bake.rotation, places_[i].position_m} *
                      Pose{glm::angleAxis(places_[i].turn_rad, glm::dvec3(0, 1, 0)), {0, 0, 0}};
    const auto hit = sphere_hit(ray.origin, ray.direction, pose * glm::dvec3(b.centre()),
                                kOfHalfDiagonal * double(glm::length(b.high - b.low)) / 2);
    if (hit && *hit < distance) distance = *hit, nearest = i;
  }
  return nearest;
}

std::optional<glm::dvec3> ObjectMouse::on_plane(std::size_t object, const Ray& ray) const {
  const glm::dvec3 normal = normal_of(scene_.objects[object]);
  const double along =
      glm::dot(places_[object].position_m - ray.origin, normal) / glm::dot(ray.direction, normal);
  if (!(along > 0 && along < kFar_m)) return std::nullopt;
  return ray.origin + along * ray.direction;
}

void ObjectMouse::put(std::size_t object) {
  // A scene's own objects at finite places on their planes: nothing is refused.
  (void)move_(scene_.objects[object].name, places_[object]);
}

void ObjectMouse::toggle(int number) {
  const auto object = static_cast<std::size_t>(number - 1);
  if (number < 1 || object >= visible_.size()) return;
  visible_[object] = !visible_[object];
  if (held_ && held_->object == object) held_.reset();
  (void)show_(scene_.objects[object].name, visible_[object]);
}

void ObjectMouse::hold_or_go_on() {
  held_still_ = !held_still_;
  for (const runtime::PreparedObject& o : scene_.objects)
    if (o.animation || o.spin_rpm != 0) (void)play_(o.name, {.speed = held_still_ ? 0. : 1.});
}

void ObjectMouse::drag(const Ray& ray) {
  const auto floor = on_plane(held_->object, ray);
  if (!floor) return;
  places_[held_->object].position_m = *floor + held_->grip_m;
  put(held_->object);
}

void ObjectMouse::turn(double angle_rad) {
  if (angle_rad == 0) return;
  places_[held_->object].turn_rad += angle_rad;
  put(held_->object);
}

void ObjectMouse::lift(double by_m) {
  const runtime::PreparedObject& o = scene_.objects[held_->object];
  if (by_m == 0 || o.animation || !o.baked.receiver) return;
  glm::dvec3& place = places_[held_->object].position_m;
  const glm::dvec3 normal = normal_of(o);
  const double height = glm::dot(place - o.world_from_bake.translation, normal);
  place += (std::max(0., height + by_m) - height) * normal;
  put(held_->object);
}

// By so much more, in the world's direction.
void ObjectMouse::lean(double angle_rad, const glm::dvec3& towards) {
  const runtime::PreparedObject& o = scene_.objects[held_->object];
  if (angle_rad == 0 || o.animation) return;
  runtime::ObjectPlace& place = places_[held_->object];
  const glm::dvec3 own = glm::conjugate(o.world_from_bake.rotation *
                                        glm::angleAxis(place.turn_rad, glm::dvec3(0, 1, 0))) *
                         towards;
  const double flat = std::hypot(own.x, own.z);
  if (flat < 1e-6) return;
  const double x = place.lean_rad * std::sin(place.lean_towards_rad) + angle_rad * own.x / flat,
               z = place.lean_rad * std::cos(place.lean_towards_rad) + angle_rad * own.z / flat;
  place.lean_rad = std::hypot(x, z);
  place.lean_towards_rad = std::atan2(x, z);
  put(held_->object);
}

void ObjectMouse::update(const compositor::Pointer& pointer, const calib::CameraModel& camera,
                         const Pose& world_from_camera) {
  toggle(pointer.number);
  if (pointer.space) hold_or_go_on();
  const bool pressed = pointer.left || pointer.right;
  const bool before = std::exchange(pressed_, pressed), begins = pressed && !before;
  const glm::dvec2 moved = pointer.place - std::exchange(last_, pointer.place);
  const auto seen = calib::direction_from_pixel(
      camera, {pointer.place.x * camera.width, pointer.place.y * camera.height});
  if (!pressed && pointer.wheel == 0) held_.reset();
  if (!seen || (!pressed && pointer.wheel == 0)) return;
  const Ray ray{world_from_camera.translation, world_from_camera.rotation * *seen};
  if (begins || (!held_ && pointer.wheel != 0)) {
    held_.reset();
    const auto object = object_at(ray);
    if (!object) return;
    const auto floor = on_plane(*object, ray);
    held_ = Held{*object, floor ? places_[*object].position_m - *floor : glm::dvec3(0),
                 glm::distance(ray.origin, places_[*object].position_m)};
  }
  if (!held_) return;
  const bool drags = pointer.left && !begins, turns = pointer.right && !begins;
  if (drags && pointer.shift)
    lift(-moved.y * camera.height / camera.focal_px.y * held_->distance_m);
  else if (drags)
    drag(ray);
  turn((turns ? 2 * kPi * moved.x : 0) + kWheelTurn_rad * pointer.wheel);
  if (turns) lean(-kPi * moved.y, world_from_camera.rotation * glm::dvec3(0, 0, -1));
}

}  // namespace penumbra::tools
