// Objects under the mouse of a window, and its number keys.
#pragma once

#include <functional>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <string_view>
#include <vector>

#include "calib/camera/camera_model.h"
#include "compositor/composite/compositor.h"
#include "core/pose.h"
#include "core/result.h"
#include "runtime/scene/scene.h"
#include "runtime/shading/object_moves.h"

namespace penumbra::tools {

/// The left button drags an object along the plane that it stands on, with Shift up and down. The
/// right one and the wheel turn it about the plane's normal; up and down, the right one leans it
/// away from the camera and towards it. Key N takes the scene's Nth object away and puts it back.
/// The space bar holds all that plays or turns, and lets it go on.
/// threads: thread-bound
class ObjectMouse {
 public:
  using Move = std::function<Result<void>(std::string_view, const runtime::ObjectPlace&)>;
  using Show = std::function<Result<void>(std::string_view, bool visible)>;
  using Play = std::function<Result<void>(std::string_view, const runtime::ObjectPlayback&)>;
  /// The scene must outlive it.
  ObjectMouse(const runtime::PreparedScene& scene, Move move, Show show, Play play);
  /// After each frame, with the camera that it shows.
  void update(const compositor::Pointer& pointer, const calib::CameraModel& camera,
              const Pose& world_from_camera);

 private:
  struct Ray {
    glm::dvec3 origin, direction;
  };
  struct Held {
    std::size_t object;
    glm::dvec3 grip_m;  // from where it was taken hold of on its plane to its place
    double distance_m;  // of it from the camera
  };
  std::optional<std::size_t> object_at(const Ray& ray) const;
  std::optional<glm::dvec3> on_plane(std::size_t object, const Ray& ray) const;
  void drag(const Ray& ray);
  void lift(double by_m);
  void turn(double angle_rad);
  void lean(double angle_rad, const glm::dvec3& towards);
  void put(std::size_t object);
  void toggle(int number);
  void hold_or_go_on();

  const runtime::PreparedScene& scene_;
  Move move_;
  Show show_;
  Play play_;
  bool held_still_ = false;
  std::vector<runtime::ObjectPlace> places_;
  std::vector<char> visible_;  // by object
  std::optional<Held> held_;
  bool pressed_ = false;  // a button, at the last update
  glm::dvec2 last_{0};    // place of the pointer
};

}  // namespace penumbra::tools
