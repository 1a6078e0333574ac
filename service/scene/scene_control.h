// What clients see and change of the scene of a running pipeline.
// threads: thread-safe
#pragma once

#include <filesystem>
#include <glm/vec3.hpp>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "runtime/pipeline/pipeline.h"
#include "runtime/scene/scene.h"
#include "runtime/shading/object_moves.h"
#include "service/scene/scene_keeper.h"

namespace penumbra::service {

/// What is not given stays as it is.
struct ObjectChange {
  std::optional<glm::dvec3> position_m{};  // on the plane that the object stands on, or above it
  std::optional<glm::dvec3> shift_m{};     // or so far from where the scene has it, on the plane
  std::optional<double> turn_deg{};        // about the plane's normal, from how the scene has it
  std::optional<double> lean_deg{}, lean_towards_deg{};  // as runtime::ObjectPlace
  std::optional<bool> visible{};
  runtime::ObjectPlayback playback{};
};
/// errors: kInvalid (no JSON object, an unknown key with the nearest known one, a value of another
///         type)
Result<ObjectChange> read_object_change(std::string_view json);

/// An object that a client adds, on the plane under its place.
/// assets: the folder that files are taken from; empty: built-in ones alone
/// errors: kInvalid (as read_object_change; a name that is missing or longer than 63 bytes; a file
///         outside of the folder), kNotFound (no such file)
Result<runtime::SceneObject> read_new_object(std::string_view json,
                                             const std::filesystem::path& assets);

/// A lamp that a client adds or changes; of one that is changed what is not given stays.
/// errors: kInvalid (as read_object_change; a radius or a light out of range)
Result<shadows::Lamp> read_lamp_change(std::string_view json, const shadows::Lamp& before);

/// Whether more than place, turn and visibility differs.
bool is_another_bake(const runtime::SceneObject& a, const runtime::SceneObject& b);
bool have_same_lamps(const runtime::Scene& a, const runtime::Scene& b);

/// A scene file of a folder, by its name.
/// errors: kInvalid (no plain file name of the folder)
Result<std::filesystem::path> scene_file_in(const std::filesystem::path& folder,
                                            std::string_view name);

struct SceneFile {
  std::filesystem::path path;  // empty: none
  runtime::Scene scene;        // as it was read
};

/// threads: thread-safe
class SceneControl {
 public:
  static constexpr std::size_t kMaxObjects = 64, kMaxLamps = 16;

  /// From now on changes go to them, until others or none come. Both outlive that.
  void attach(Pipeline* pipeline, SceneKeeper* keeper);
  /// The scene that additions and removals start from.
  /// file: that it was read from; empty: none
  void set_scene(const runtime::Scene& scene, const std::filesystem::path& file = {});

  /// In effect with the next frame. One that is refused changes nothing.
  /// errors: kUnavailable (no pipeline yet), kNotFound (no such object), kNonFinite, kInvalid (off
  ///         its plane on the wrong side, nothing to play)
  Result<void> change(std::string_view object, const ObjectChange& change);
  /// There as soon as it is baked.
  /// errors: kUnavailable (no pipeline yet), kInvalid (the name is taken, too many objects)
  Result<void> add(const runtime::SceneObject& object);
  /// Out of the picture with the next frame, and then out of the scene.
  /// errors: kUnavailable (no pipeline yet), kNotFound (no such object)
  Result<void> remove(const std::string& object);
  /// Lamps are counted from 0. Shown as soon as their light is traced.
  /// errors: kUnavailable (no pipeline yet), kNotFound (no such lamp), kInvalid (too many; as
  ///         read_lamp_change)
  Result<void> add_lamp(std::string_view json);
  Result<void> change_lamp(std::size_t lamp, std::string_view json);
  Result<void> remove_lamp(std::size_t lamp);
  /// Another scene in the place of this one.
  /// errors: kUnavailable (no pipeline yet)
  Result<void> show_scene(const runtime::Scene& scene, const std::filesystem::path& file);
  /// The scene's file was read anew. What it no longer has goes, what it has now comes, and what
  /// clients added or took away stays so. Objects that are baked otherwise than before begin where
  /// the file has them. Nothing where another scene was asked for meanwhile.
  /// bakes: whether anything has to be baked, or looked up in the cache
  void follow_file(const SceneFile& last, const runtime::Scene& now, bool bakes);
  /// It cannot be baked: from now on the scene is without it.
  void forget(const std::string& object);
  /// What the scene was last read from.
  SceneFile file() const;
  /// errors: kUnavailable (no pipeline yet), kInvalid (not above 0 and at most 1)
  Result<void> set_max_shadow_error(double error);

  /// By object, as ObjectState. Null before there is a pipeline.
  nlohmann::json objects() const;
  /// Objects that are wanted, not shown yet, and not known to fail.
  std::vector<std::string> awaited() const;
  /// Planes and lamps.
  nlohmann::json surroundings() const;
  /// By object, why it is not there.
  nlohmann::json faults() const;
  std::optional<double> max_shadow_error() const;
  std::optional<runtime::ObjectState> state_of(std::string_view object) const;

 private:
  std::optional<runtime::ObjectState> find(std::string_view object) const;  // in the lock
  mutable std::mutex mutex_;
  Pipeline* pipeline_ = nullptr;  // guarded by mutex_, as are all below
  SceneKeeper* keeper_ = nullptr;
  runtime::Scene scene_;                      // as it is wanted
  std::set<std::string> added_, taken_away_;  // by clients, of the file's scene
  SceneFile file_;
  unsigned instances_ = 0;  // of objects, so far
};

}  // namespace penumbra::service
