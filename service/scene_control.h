// What clients see and change of the objects of a running pipeline.
// threads: thread-safe
#pragma once

#include <glm/vec3.hpp>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>

#include "core/result.h"
#include "runtime/pipeline/pipeline.h"
#include "runtime/shading/object_moves.h"

namespace penumbra::service {

/// What is not given stays as it is.
struct ObjectChange {
  std::optional<glm::dvec3> position_m{};  // on the plane that the object stands on
  std::optional<glm::dvec3> shift_m{};     // or so far from where the scene has it
  std::optional<double> turn_deg{};        // about the plane's normal, from how the scene has it
  std::optional<bool> visible{};
  runtime::ObjectPlayback playback{};
};
/// errors: kInvalid (no JSON object, an unknown key with the nearest known one, a value of another
///         type)
Result<ObjectChange> read_object_change(std::string_view json);

/// threads: thread-safe
class SceneControl {
 public:
  /// The pipeline that changes go to, from now on until another or none comes.
  void attach(Pipeline* pipeline);
  /// In effect with the next frame. One that is refused changes nothing.
  /// errors: kUnavailable (no pipeline yet), kNotFound (no such object), kNonFinite, kInvalid (off
  ///         its plane, nothing to play)
  Result<void> change(std::string_view object, const ObjectChange& change);
  /// By object: name, position_m, turn_deg, visible, plays. Null before there is a pipeline.
  nlohmann::json objects() const;

 private:
  struct ShownObject {
    runtime::ObjectPlace place;
    glm::dvec3 at_first{0, 0, 0};
    bool visible = true, plays = false;
  };
  mutable std::mutex mutex_;
  Pipeline* pipeline_ = nullptr;                // guarded by mutex_
  std::map<std::string, ShownObject> objects_;  // guarded by mutex_
};

}  // namespace penumbra::service
